"""The drive as values: motor, gear and load parameters, validated once, in SI units.

Symbols and signs are the paper's (Kalantari & Saadat Foomani, Scientia Iranica B 16(6), 2009), except
that ``gear_ratio`` is its n = R1/R2 and ``contact_exponent`` the n of its eq 11.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from backlash_ros.drivetrain.quantity import Validated, quantity

POWER, POWER_NO_PULL, ELASTIC, RESTITUTION = range(4)
CONTACT_LAWS = ("power", "power_no_pull", "elastic", "restitution")
"""Names of the contact laws, see `contact`."""

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
    voltage_limit: float = quantity("largest magnitude of the voltage", "V", above=0, at_most=1e4)
    current_limit: float = quantity("largest magnitude of a commanded current", "A", above=0, at_most=1e5, default=12.0)


@dataclass(frozen=True)
class Gear(Validated):
    """Spur gear pair with backlash and the contact law of its teeth (eqs 10 to 13).

    The power laws use beta, alpha and the exponent, `elastic` the tooth stiffness and damping, `restitution` the
    stiffness and the coefficient of restitution.
    """

    section: ClassVar[str] = "gear"

    motor_radius: float = quantity("pitch radius R1 of the motor's gear", "m", at_least=1e-4, at_most=10)
    load_radius: float = quantity("pitch radius R2 of the load's gear", "m", at_least=1e-4, at_most=10)
    backlash: float = quantity("backlash d along the pitch line", "m", at_least=1e-9, at_most=0.1)
    contact_stiffness: float = quantity("elastic force beta at |gap| = d/2", "N", above=0, at_most=1e7)
    contact_damping: float = quantity("contact damping alpha at |gap| = d/2", "N s/m", at_least=0, at_most=1e8)
    contact_exponent: int = quantity("exponent n of the elastic force, odd", "", at_least=1, at_most=101, whole=True)
    tooth_stiffness: float = quantity("stiffness k of the linear laws", "N/m", above=0, at_most=1e12, default=4e5)
    tooth_damping: float = quantity("damping c of the elastic law", "N s/m", at_least=0, at_most=1e8, default=50.0)
    restitution: float = quantity("coefficient of restitution e", "", at_least=0.2, at_most=1, default=0.5)
    contact_law: str = "power"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contact_exponent % 2 != 1:
            raise ValueError(f"gear.contact_exponent must be an odd integer, got {self.contact_exponent!r}")
        if self.contact_law not in CONTACT_LAWS:
            raise ValueError(f"gear.contact_law must be one of {list(CONTACT_LAWS)}, got {self.contact_law!r}")

    @property
    def ratio(self) -> float:
        """Gear ratio n = R1/R2: theta_l = n theta_m while the teeth are in contact."""
        return self.motor_radius / self.load_radius

    @property
    def backlash_angle(self) -> float:
        """Backlash b = d/R2 as an angle of the output shaft, rad."""
        return self.backlash / self.load_radius


@dataclass(frozen=True)
class Load(Validated):
    """What the output shaft carries (eq 1)."""

    section: ClassVar[str] = "load"

    inertia: float = quantity("load inertia J_l", "kg m^2", at_least=1e-9, at_most=1e5)
    viscous_friction: float = quantity("load viscous friction B_l", "N m s/rad", at_least=0, at_most=1e5)
    coulomb_friction: float = quantity("load Coulomb friction", "N m", at_least=0, at_most=1e5, default=0.0)


class PlantConstants(NamedTuple):
    """The drive as the compiled functions read it; field names are the equations' symbols.

    An infinite L is an imposed current.
    """

    R: float
    L: float
    K_m: float
    J_m: float
    B_m: float
    R1: float
    R2: float
    half_gap: float
    beta: float
    alpha: float
    exponent: int
    law: int
    tooth_stiffness: float
    tooth_damping: float
    J_l: float
    B_l: float
    coulomb: float
    current_scale: float
    speed_scale: float
    energy_scale: float


@dataclass(frozen=True)
class Drive:
    """A geared servo: motor, gear and load, and which of `COMMAND_INTERFACES` it takes."""

    motor: Motor
    gear: Gear
    load: Load
    command_interface: str = "voltage"

    def __post_init__(self) -> None:
        if self.command_interface not in COMMAND_INTERFACES:
            raise ValueError(
                f"command_interface must be one of {list(COMMAND_INTERFACES)}, got {self.command_interface!r}"
            )

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
    gear=Gear(
        motor_radius=0.005,
        load_radius=0.05,
        backlash=1.0e-3,
        contact_stiffness=10.0,
        contact_damping=200.0,
        contact_exponent=21,
    ),
    load=Load(inertia=5.0e-4, viscous_friction=5.0e-3),
)
"""The reference drive. The paper prints no parameter values; with these each of its qualitative claims holds."""
