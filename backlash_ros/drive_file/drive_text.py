"""Writes a drive file with a comment at each value: identified or not."""

import math
import re
from dataclasses import fields

from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain.contact import law_name
from backlash_ros.drivetrain.parameters import IDENTIFIED
from backlash_ros.foundation.quantity import Validated, quantities
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.identify import Identified

LONGEST_DELAY = 10
"""Largest delay of a controller, in periods."""


def yaml_number(value: float | int) -> str:
    """Return a number as YAML 1.1 and ROS read it: a float has a point."""
    if isinstance(value, int):
        return str(value)
    text = repr(float(value))
    if "e" in text:
        digits, exponent = text.split("e")
        return f"{digits if '.' in digits else f'{digits}.0'}e{exponent}"
    return text if "." in text else f"{text}.0"


def _rounded(value: float, finding: Finding | None) -> float:
    """Return an identified value with six digits, or 0 if it is negligible beside its uncertainty."""
    if finding is not None and finding.told and abs(value) < 1e-3 * finding.uncertainty:
        return 0.0
    return float(f"{value:.6g}")


def _remark(finding: Finding | None, found: bool, unit: str) -> str:
    """Return the comment at a value."""
    if finding is not None and finding.told:
        remark = f"found, +- {finding.uncertainty:.2g}"
    elif finding is not None and finding.rough:
        remark = f"found roughly, +- {finding.uncertainty:.2g}"
    elif found:
        remark = "found"
    elif finding is not None:
        remark = "as told: the recording cannot tell"
    else:
        remark = "as told"
    return f"# {remark} [{unit}]" if unit else f"# {remark}"


def _section(part: Validated, name: str, found: Identified, indent: int, *, whole: bool = False) -> list[str]:
    """Return the lines of one section; a ``whole`` one was identified or given as one."""
    keys = {finding.key: finding for finding in found.findings if finding.key}
    lines = [f"{' ' * indent}{name}:"]
    for field in fields(part):
        if field.name not in quantities(type(part)):
            continue
        key = f"{part.section}.{field.name}"
        replaced = key in found.replaced or (whole and "contact" in found.replaced)
        remark = _remark(keys.get(key), replaced, quantities(type(part))[field.name].unit)
        value = getattr(part, field.name)
        if replaced and not isinstance(value, int):
            value = _rounded(value, keys.get(key))
        lines.append(f"{' ' * (indent + 2)}{f'{field.name}: {yaml_number(value)}':34s} {remark}".rstrip())
    return lines


def drive_text(found: Identified, axis: Axis, counts: tuple[float, float], source: str) -> str:
    """Return a drive file with the identified values, for the nodes, the simulator and ``evaluate``.

    Parameters
    ----------
    axis : the axis that was given, whose ends of travel and zero are kept
    counts : of both encoders per turn of their shafts; 0 if unknown
    source : what was identified, in words
    """
    drive, contact = found.drive, found.drive.gear.contact
    lines = [
        f"# A drive as `backlash identify` found it in {re.sub(r'[^ -~]', '?', source)}.",
        "# What is `as told` is from the drive that was given; `found` has its standard uncertainty. SI units.",
        "/**:",
        "  ros__parameters:",
        f"    rate: {yaml_number(float(f'{1.0 / found.period:.6g}'))}",
        f"    command_interface: {drive.command_interface}",
    ]
    for part, name in ((drive.motor, "motor"), (drive.gear, "gear"), (drive.load, "load")):
        lines += _section(part, name, found, 4)
    lines += ["    contact:", f"      law: {law_name(contact)}"]
    lines += _section(contact, law_name(contact), found, 6, whole=True)
    ends = {"position_lower": axis.position_lower, "position_upper": axis.position_upper}
    kept = [f"      {name}: {yaml_number(end)}  # as told [rad]" for name, end in ends.items() if math.isfinite(end)]
    lines += ["    limits:", *kept] if kept else []
    if axis.zero:
        lines.append(f"    zero: {yaml_number(axis.zero)}  # as told [rad]")
    sensors = {"motor_counts": counts[0], "load_counts": counts[1]}
    offset = found.of("sensors.load_offset")
    if offset.told:
        sensors["load_offset"] = _rounded(offset.value, offset)
    lines.append("    sensors:")
    lines += ["      measured: [theta_m, theta_l]"]
    lines += [f"      {name}: {yaml_number(float(value))}" for name, value in sensors.items()]
    delay = found.of("delay.command")
    if delay.told:
        late = _rounded(delay.value, delay)
        lines += ["    delay:", f"      command: {yaml_number(late)}"]
        lines.append(f"    loop_delay: {yaml_number(min(late, LONGEST_DELAY * found.period))}")
    if found.replaced >= IDENTIFIED:
        lines.append("    identified: true")
    if found.fit is not None:
        lines += [f"    {name}: {yaml_number(_rounded(value, None))}" for name, value in found.fit.unexplained.items()]
    torque = found.of("tau_l")
    if torque.told:
        assert found.fit is not None
        rounding = {torque.key: torque, (slope := found.of("dtau_l/dtheta_l")).key: slope}
        lines += [
            f"    {name}: {yaml_number(_rounded(value, rounding.get(name)))}"
            for name, value in found.fit.load_torque.items()
        ]
    if found.gap is not None and found.gap.valid:
        lines.append(f"    backlash_angle: {yaml_number(_rounded(drive.gear.backlash_angle, None))}")
    return "\n".join(lines) + "\n"
