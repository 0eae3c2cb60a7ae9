"""The drive as values: motor, gear and load parameters, validated once, in SI units.

Symbols and signs are the paper's (Kalantari & Saadat Foomani, Scientia Iranica B 16(6), 2009), except
that ``gear_ratio`` is its n = R1/R2 and ``contact_exponent`` the n of its eq 11.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from backlash_ros.drivetrain.quantity import Validated, quantity


@dataclass(frozen=True)
class Motor(Validated):
    """DC servomotor (eqs 7, 8) and the supply that limits its voltage."""

    section: ClassVar[str] = "motor"

    resistance: float = quantity("armature resistance R", "ohm", above=0, at_most=1e4)
    inductance: float = quantity("armature inductance L", "H", at_least=1e-7, at_most=10)
    torque_constant: float = quantity("torque constant K_m, also the back-EMF constant", "N m/A", above=0, at_most=1e3)
    inertia: float = quantity("rotor inertia J_m", "kg m^2", at_least=1e-9, at_most=1e3)
    viscous_friction: float = quantity("rotor viscous friction B_m", "N m s/rad", at_least=0, at_most=1e3)
    voltage_limit: float = quantity("largest magnitude of the voltage", "V", above=0, at_most=1e4)


@dataclass(frozen=True)
class Gear(Validated):
    """Spur gear pair with backlash and the contact law of its teeth (eqs 10 to 13)."""

    section: ClassVar[str] = "gear"

    motor_radius: float = quantity("pitch radius R1 of the motor's gear", "m", at_least=1e-4, at_most=10)
    load_radius: float = quantity("pitch radius R2 of the load's gear", "m", at_least=1e-4, at_most=10)
    backlash: float = quantity("backlash d along the pitch line", "m", at_least=1e-9, at_most=0.1)
    contact_stiffness: float = quantity("elastic force beta at |gap| = d/2", "N", above=0, at_most=1e7)
    contact_damping: float = quantity("contact damping alpha at |gap| = d/2", "N s/m", at_least=0, at_most=1e8)
    contact_exponent: int = quantity("exponent n of the elastic force, odd", "", at_least=1, at_most=101)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contact_exponent % 2 != 1:
            raise ValueError(f"gear.contact_exponent must be an odd integer, got {self.contact_exponent!r}")

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


class PlantConstants(NamedTuple):
    """The drive as the compiled functions read it; field names are the equations' symbols."""

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
    J_l: float
    B_l: float
    current_scale: float
    speed_scale: float


@dataclass(frozen=True)
class Drive:
    """A geared servo: motor, gear and load."""

    motor: Motor
    gear: Gear
    load: Load

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
    def motor_share(self) -> float:
        """Share of the gap that the load crosses in a limit cycle, J_r/(J_r + J_l) by momentum exchange."""
        return self.reflected_inertia / self.effective_inertia

    def constants(self) -> PlantConstants:
        """Return the named tuple that the compiled functions take."""
        motor, gear, load = self.motor, self.gear, self.load
        return PlantConstants(
            R=float(motor.resistance),
            L=float(motor.inductance),
            K_m=float(motor.torque_constant),
            J_m=float(motor.inertia),
            B_m=float(motor.viscous_friction),
            R1=float(gear.motor_radius),
            R2=float(gear.load_radius),
            half_gap=0.5 * gear.backlash,
            beta=float(gear.contact_stiffness),
            alpha=float(gear.contact_damping),
            exponent=int(gear.contact_exponent),
            J_l=float(load.inertia),
            B_l=float(load.viscous_friction),
            current_scale=motor.voltage_limit / motor.resistance,
            speed_scale=motor.voltage_limit / motor.torque_constant,
        )


NOMINAL_DRIVE = Drive(
    motor=Motor(
        resistance=2.0,
        inductance=2.0e-3,
        torque_constant=0.05,
        inertia=2.0e-5,
        viscous_friction=2.0e-5,
        voltage_limit=24.0,
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
