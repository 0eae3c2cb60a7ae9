"""Conditions on the parameters of a drive, in words, by which drives are compared."""

from collections.abc import Callable

from backlash_ros.studies.evaluation.population import Member


def _stall(member: Member) -> float:
    return member.drive.standstill_torque()


def _inertia_ratio(member: Member) -> float:
    return member.drive.load.inertia / member.drive.reflected_inertia


CONDITIONS: dict[str, Callable[[Member], bool]] = {
    "J_l above J_r/2": lambda m: _inertia_ratio(m) > 0.5,
    "J_l below J_r/8": lambda m: _inertia_ratio(m) < 0.125,
    "gap below 0.01 rad": lambda m: m.drive.gear.backlash_angle < 0.01,
    "gap above 0.04 rad": lambda m: m.drive.gear.backlash_angle > 0.04,
    "gap of less than 20 counts": lambda m: m.drive.gear.backlash_angle < 20 * m.load_count,
    "gap that varies": lambda m: m.drive.gear.backlash_variation > 0,
    "load torque": lambda m: m.load_torque != 0,
    "gravity": lambda m: m.drive.load.gravity_torque > 0,
    "friction on the load": lambda m: m.drive.load.coulomb_friction > 0,
    "friction on the motor": lambda m: m.drive.motor.coulomb_friction > 0,
    "friction of a side above 1 % of the stall torque": lambda m: (
        max(m.drive.load.coulomb_friction, m.drive.motor.coulomb_friction / m.drive.gear.ratio) > 0.01 * _stall(m)
    ),
    "free load": lambda m: m.free,
    "load that cannot be outrun": lambda m: not m.can_outrun,
    "elastic contact": lambda m: m.drive.gear.contact.section == "contact.elastic",
    "power contact": lambda m: m.drive.gear.contact.section == "contact.power",
    "eccentricity": lambda m: m.sensors.load_eccentricity > 0,
    "250 Hz": lambda m: m.rate < 500,
    "1 kHz": lambda m: m.rate > 500,
    "delay of half a period": lambda m: 0.25 < m.delay.command * m.rate < 0.75,
    "delay of one period": lambda m: m.delay.command * m.rate > 0.75,
    "no delay": lambda m: m.delay.command == 0,
    "reduction above 50": lambda m: m.drive.gear.reduction > 50,
    "stall torque below 3 N m": lambda m: _stall(m) < 3,
    "stall torque above 12 N m": lambda m: _stall(m) > 12,
}
"""Each condition by its name."""
NOT_LEARNED = "gap not learned"
CONDITION_NAMES = (*CONDITIONS, NOT_LEARNED)
"""In the order of their bits."""


def conditions_of(member: Member, learned: bool) -> int:
    """Return which of the conditions hold, as bits; they fit into the whole numbers of a double."""
    holds = [*(condition(member) for condition in CONDITIONS.values()), not learned]
    return sum(1 << bit for bit, true in enumerate(holds) if true)
