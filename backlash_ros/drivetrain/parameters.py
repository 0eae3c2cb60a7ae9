"""The drive as values: motor, gear and load parameters, validated once, in SI units.

Symbols and signs are the paper's (Kalantari & Saadat Foomani, Scientia Iranica B 16(6), 2009), except that ``ratio``
is its n = R1/R2 and the exponent of `contacts.power` the n of its eq 11.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

from backlash_ros.drivetrain.contact import Contact, law_name
from backlash_ros.drivetrain.contacts import CONTACTS
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.drivetrain.effects.parameters import Effects
from backlash_ros.foundation.markup import pairs
from backlash_ros.foundation.quantity import Validated, quantities, quantity, take
from backlash_ros.foundation.reading.misspelled import check_known
from backlash_ros.foundation.reading.parameter_files import by_name, own, read_files, section_of

COMMAND_INTERFACES = ("voltage", "current")
"""What the drive takes as its command: the motor's voltage, V, or its current, A, which its own inner loop closes."""


@dataclass(frozen=True)
class Motor(Validated):
    """DC servomotor (eqs 7, 8) and what its amplifier gives at most."""

    section: ClassVar[str] = "motor"

    resistance: float = quantity("armature resistance R", "ohm", above=0, at_most=1e6)
    inductance: float = quantity("armature inductance L", "H", at_least=1e-7, at_most=10)
    torque_constant: float = quantity("torque constant K_m, also the back-EMF constant", "N m/A", above=0, at_most=1e3)
    inertia: float = quantity("rotor inertia J_m", "kg m^2", at_least=1e-9, at_most=1e3)
    viscous_friction: float = quantity("rotor viscous friction B_m", "N m s/rad", at_least=0, at_most=1e3)
    voltage_limit: float = quantity("largest magnitude of the motor voltage", "V", above=0, at_most=1e4)
    current_limit: float = quantity("largest magnitude of a commanded current", "A", above=0, at_most=1e5, default=12.0)
    coulomb_friction: float = quantity(
        "Coulomb friction of the rotor, before the gear", "N m", at_least=0, at_most=1e5, default=0.0
    )


@dataclass(frozen=True)
class Gear(Validated):
    """Spur gear pair with backlash, its losses, and the contact of its teeth (eqs 10 to 13).

    Half the backlash, where the output stands at theta_l, is d/2 (1 + variation cos(cycles theta_l + phase)).
    """

    section: ClassVar[str] = "gear"

    reduction: float = quantity(
        "turns of the motor for one turn of the load: 10 for 10:1", "", at_least=1e-3, at_most=1e5
    )
    backlash_angle: float = quantity(
        "backlash b at the output shaft, its mean over a turn", "rad", at_least=1e-9, at_most=3.2
    )
    load_radius: float = quantity(
        "pitch radius R2 of the load's gear; only the tooth forces depend on it",
        "m",
        at_least=1e-4,
        at_most=10,
        default=0.05,
    )
    backlash_variation: float = quantity(
        "amplitude of the backlash's variation over a turn of the output, as a share of its mean",
        "",
        at_least=0,
        at_most=0.9,
        default=0.0,
    )
    backlash_cycles: int = quantity(
        "periods of that variation in one turn of the output", "", at_least=1, at_most=1000, whole=True, default=1
    )
    backlash_phase: float = quantity(
        "phase of that variation at a load angle of 0; the backlash is widest at phase 0",
        "rad",
        at_least=-6.3,
        at_most=6.3,
        default=0.0,
    )
    efficiency_forward: float = quantity(
        "efficiency of the teeth while power flows from motor to load", "", at_least=1e-3, at_most=1, default=1.0
    )
    efficiency_backward: float = quantity(
        "efficiency of the teeth while power flows from load to motor; 0: self-locking",
        "",
        at_least=0,
        at_most=1,
        default=1.0,
    )
    contact: Contact = field(default_factory=PowerContact)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.contact, Contact):
            raise ValueError(f"gear.contact must be a Contact, such as PowerContact(), got {self.contact!r}")

    @property
    def ratio(self) -> float:
        """Gear ratio n = R1/R2: theta_l = n theta_m while the teeth are in contact."""
        return 1.0 / self.reduction

    @property
    def motor_radius(self) -> float:
        """Pitch radius R1 of the motor's gear, m."""
        return self.load_radius / self.reduction

    def backlash_at(self, theta_l: float) -> float:
        """Return the backlash where the load is at ``theta_l`` (rad), rad at the output."""
        return self.backlash_angle * (
            1.0 + self.backlash_variation * math.cos(self.backlash_cycles * theta_l + self.backlash_phase)
        )

    @property
    def backlash(self) -> float:
        """Backlash d = b R2 along the pitch line, its mean over a turn, m."""
        return self.backlash_angle * self.load_radius

    @property
    def edge_stiffness(self) -> float:
        """The spring that stands for the teeth at the edge of the gap, N/m along the pitch line."""
        return self.contact.edge_stiffness(0.5 * self.backlash, self.load_radius)

    def wind_up(self, torque: float) -> float:
        """Return by how much a torque on the output shaft (N m) presses the teeth in, as an angle there, rad."""
        return self.contact.deflection(torque, 0.5 * self.backlash, self.load_radius)


@dataclass(frozen=True)
class Load(Validated):
    """What the output shaft carries (eq 1)."""

    section: ClassVar[str] = "load"

    inertia: float = quantity("load inertia J_l", "kg m^2", at_least=1e-9, at_most=1e5)
    viscous_friction: float = quantity("load viscous friction B_l", "N m s/rad", at_least=0, at_most=1e5)
    coulomb_friction: float = quantity(
        "Coulomb friction of the load, behind the gear", "N m", at_least=0, at_most=1e5, default=0.0
    )
    gravity_torque: float = quantity(
        "largest gravity torque of the load, m g l; gravity pulls with gravity_torque sin(theta_l + gravity_offset)",
        "N m",
        at_least=0,
        at_most=1e5,
        default=0.0,
    )
    gravity_offset: float = quantity(
        "angle between the load and straight down when its encoder reads 0",
        "rad",
        at_least=-6.3,
        at_most=6.3,
        default=0.0,
    )


@dataclass(frozen=True)
class Drive:
    """A geared servo: motor, gear and load, which of `COMMAND_INTERFACES` it takes, and the `Effects` of real axes.

    ``motor`` is what its data sheet says: see `as_built`. Only a simulation has effects.
    """

    motor: Motor
    gear: Gear
    load: Load
    command_interface: str = "voltage"
    effects: Effects = field(default_factory=Effects)

    def __post_init__(self) -> None:
        if self.command_interface not in COMMAND_INTERFACES:
            raise ValueError(
                f"command_interface must be one of {list(COMMAND_INTERFACES)}, got {self.command_interface!r}"
            )

    @classmethod
    def read(cls, *paths: str | PathLike[str]) -> "Drive":
        """Return the drive of parameter files, such as config/nominal_drive.yaml; later files override earlier ones.

        Missing values are those of the nominal drive; parameters of the nodes that are not the drive's are ignored.

        Raises
        ------
        OSError
            If a file cannot be read.
        ValueError
            Names the file and the parameter that is out of bounds, misspelled or given twice.

        Examples
        --------
        >>> drive = Drive.read("config/nominal_drive.yaml")
        >>> drive == NOMINAL_DRIVE
        True
        """
        if not paths:
            raise ValueError("Drive.read needs a parameter file, such as config/nominal_drive.yaml")

        def take(parameters: Mapping[str, Any]) -> Drive:
            check_known(by_name(parameters), _names(), tuple)
            return drive_in(parameters)

        return read_files([Path(path) for path in paths], take)

    def _repr_html_(self) -> str:
        """Return the parameters as a table, for notebooks, without those that are at their defaults."""
        rows = [("command_interface", self.command_interface), ("contact.law", law_name(self.gear.contact))]
        for part in (self.motor, self.gear, self.load, self.gear.contact, self.effects):
            defaults = {each.name: each.default for each in fields(part)}
            for name, described in quantities(type(part)).items():
                if (value := getattr(part, name)) != defaults[name]:
                    rows.append((f"{part.section}.{name}", f"{value:.6g} {described.unit}".rstrip()))
        return pairs(rows)

    @property
    def as_built(self) -> "Drive":
        """The drive with the motor as it is built, which is what a simulation moves."""
        motor = self.effects.built(self.motor)
        if motor is self.motor:
            return self
        return replace(self, motor=motor, effects=self.effects.without_errors)

    @property
    def takes_current(self) -> bool:
        """Whether the command is the motor's current, so that the electrical pole is the drive's."""
        return self.command_interface == "current"

    @property
    def command_unit(self) -> str:
        """Unit of the command: V or A."""
        return "A" if self.takes_current else "V"

    @property
    def command_limit(self) -> float:
        """Largest magnitude of the command that the drive obeys, V or A."""
        return self.motor.current_limit if self.takes_current else self.motor.voltage_limit

    def standstill_torque(self, command: float = math.inf) -> float:
        """Return the torque on the output shaft that a command (V or A) makes at standstill, N m.

        By default the largest that the drive obeys. A current is at most what the law's voltage, within its limit,
        drives through the winding that is emulated.
        """
        motor, command = self.motor, min(command, self.command_limit)
        voltage = min(command * motor.resistance if self.takes_current else command, motor.voltage_limit)
        return motor.torque_constant * voltage / motor.resistance / self.gear.ratio

    @property
    def no_load_speed(self) -> float:
        """Speed of the output at which the back-EMF is as large as the largest voltage, rad/s."""
        return self.gear.ratio * self.motor.voltage_limit / self.motor.torque_constant

    @property
    def reflected_inertia(self) -> float:
        """Motor inertia seen at the output, J_r = J_m/n^2, kg m^2."""
        return self.motor.inertia / self.gear.ratio**2

    @property
    def effective_inertia(self) -> float:
        """Inertia at the output while rigid, J_e of eq 5, kg m^2."""
        return self.load.inertia + self.reflected_inertia

    @property
    def effective_friction(self) -> float:
        """Viscous friction at the output while rigid, B_e of eq 6, N m s/rad."""
        return self.load.viscous_friction + self.motor.viscous_friction / self.gear.ratio**2

    @property
    def contact_mass(self) -> float:
        """Reduced mass of both gears along the pitch line, as they meet, kg."""
        gear = self.gear
        return 1.0 / (gear.motor_radius**2 / self.motor.inertia + gear.load_radius**2 / self.load.inertia)

    @property
    def motor_share(self) -> float:
        """Share of the gap that the load crosses in a limit cycle, J_r/(J_r + J_l) by momentum exchange."""
        return self.reflected_inertia / self.effective_inertia


FOUND = (
    "load.",
    "contact.",
    "gear.backlash_angle",
    "motor.coulomb_friction",
    "motor.torque_constant",
    "motor.resistance",
)
"""Beginnings of the names of what is found of a drive once it is there; the rest is on data sheets."""
IDENTIFIED = {"load.inertia", "load.coulomb_friction"}
"""Parameters with which a drive counts as identified, so that a law may plan with it."""


def to_use(found: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters to set for what was ``found``, by name, and ``identified`` if that is enough."""
    return {**found, **({"identified": True} if found.keys() >= IDENTIFIED else {})}


def values_of(drive: Drive) -> dict[str, float | int | str]:
    """Return the parameters of a drive by name, the contact's own alone, without its effects."""
    parts = (drive.motor, drive.gear, drive.load, drive.gear.contact)
    numbers = {f"{part.section}.{name}": getattr(part, name) for part in parts for name in quantities(type(part))}
    return {**numbers, "contact.law": law_name(drive.gear.contact), "command_interface": drive.command_interface}


def drive_of(values: Mapping[str, Any]) -> Drive:
    """Return the drive that a set of parameters stands for; ValueError names the one that is out of bounds.

    It has the effects that are among them, or none.
    """
    contact = take(CONTACTS.choose("contact.law", values["contact.law"]), values)
    gear = take(Gear, values, contact=contact)
    named = {f"{Effects.section}.{name}": getattr(Effects(), name) for name in quantities(Effects)}
    effects = take(Effects, {**named, **values})
    return Drive(take(Motor, values), gear, take(Load, values), values["command_interface"], effects)


def drive_in(parameters: Mapping[str, Any]) -> Drive:
    """Return the drive that parameters in sections describe; missing values are those of the nominal drive.

    Raises
    ------
    ValueError
        Names the parameter that is out of bounds, or unknown in a section of the drive.
    """
    contact = section_of(parameters, "contact")
    law = CONTACTS.choose("contact.law", str(contact.get("law", "power")))
    teeth = law(**own(law, section_of(contact, law.section.removeprefix("contact."))))

    def values(nominal: Validated) -> dict[str, Any]:
        given = own(type(nominal), section_of(parameters, nominal.section))
        return {name: getattr(nominal, name) for name in quantities(type(nominal))} | given

    return Drive(
        Motor(**values(NOMINAL_DRIVE.motor)),
        Gear(**values(NOMINAL_DRIVE.gear), contact=teeth),
        Load(**values(NOMINAL_DRIVE.load)),
        str(parameters.get("command_interface", NOMINAL_DRIVE.command_interface)),
        Effects(**own(Effects, section_of(parameters, Effects.section))),
    )


def _names() -> set[str]:
    """Return the names of all parameters of drives, with those of every contact law."""
    parts: tuple[type[Validated], ...] = (Motor, Gear, Load, Effects, *CONTACTS.values())
    numbers = {f"{part.section}.{name}" for part in parts for name in quantities(part)}
    return numbers | {"contact.law", "command_interface"}


NOMINAL_DRIVE = Drive(
    motor=Motor(
        resistance=2.0,
        inductance=2.0e-3,
        torque_constant=0.05,
        inertia=2.0e-5,
        viscous_friction=2.0e-5,
        voltage_limit=24.0,
        current_limit=12.0,
    ),
    gear=Gear(reduction=10.0, backlash_angle=0.02),
    load=Load(inertia=5.0e-4, viscous_friction=5.0e-3),
)
"""The reference drive. The paper prints no parameter values; with these each of its qualitative claims holds."""
