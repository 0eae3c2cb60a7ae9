"""Motors by name, as their data sheets have them, and the constants that follow from a data sheet."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

RPM = math.pi / 30.0
"""rad/s of a turn a minute."""


@dataclass(frozen=True)
class DataSheet:
    """What a data sheet says of a motor, in SI units; nan where it says nothing.

    Speeds, torques and angles are those of the output: of a motor without a gear, of its shaft. ``source``: where it
    is said.
    """

    name: str
    voltage: float
    resistance: float
    inductance: float
    torque_constant: float
    inertia: float
    no_load_speed: float
    no_load_current: float
    stall_current: float
    stall_torque: float
    reduction: float
    backlash_angle: float
    motor_counts: float
    load_counts: float
    source: str

    @property
    def ratio(self) -> float:
        """Turns of the motor for one of the output: 1 without a gear."""
        return 1.0 if math.isnan(self.reduction) else self.reduction

    @property
    def has_winding(self) -> bool:
        """Whether it says the constants of the winding itself."""
        return not math.isnan(self.resistance + self.torque_constant)

    @property
    def winding(self) -> tuple[float, float]:
        """Resistance, ohm, and torque constant, N m/A: as the sheet says them, or as its voltage and speed tell.

        At standstill U = R I; without load U = R I0 + K w. Of a sheet without a current at standstill, the torque there
        is K I: the gear's losses then count as resistance.
        """
        speed, idle = self.ratio * self.no_load_speed, 0.0 if math.isnan(self.no_load_current) else self.no_load_current
        resistance, constant = self.resistance, self.torque_constant
        if math.isnan(resistance):
            resistance = self.voltage / self.stall_current
        if math.isnan(resistance):
            lost = self.voltage * self.ratio * idle / self.stall_torque
            constant = self.voltage / (speed + lost)
            resistance = constant * self.voltage * self.ratio / self.stall_torque
        if math.isnan(constant):
            constant = (self.voltage - resistance * idle) / speed
        return resistance, constant


_UNITS = {
    "inductance": ("mH", 1e-3),
    "torque_constant": ("mNm_per_A", 1e-3),
    "inertia": ("gcm2", 1e-7),
    "no_load_speed": ("rpm", RPM),
    "backlash_angle": ("deg", math.pi / 180.0),
    "voltage": ("V", 1.0),
    "resistance": ("ohm", 1.0),
    "no_load_current": ("A", 1.0),
    "stall_current": ("A", 1.0),
    "stall_torque": ("Nm", 1.0),
}


def data_sheets() -> list[DataSheet]:
    """Return the motors of ``motors.csv``, whose columns have the units of data sheets in their names."""
    with Path(__file__).with_name("motors.csv").open(encoding="utf-8", newline="") as file:
        return [_sheet(row) for row in csv.DictReader(file)]


def _sheet(row: dict[str, str]) -> DataSheet:
    def number(column: str, factor: float = 1.0) -> float:
        return factor * float(row[column] or "nan")

    values = {name: number(f"{name.removesuffix('_angle')}_{unit}", factor) for name, (unit, factor) in _UNITS.items()}
    values |= {name: number(name) for name in ("reduction", "motor_counts", "load_counts")}
    return DataSheet(name=row["name"], source=row["source"], **values)
