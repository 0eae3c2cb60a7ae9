"""Notes on what a file for a simulator leaves out of a drive."""

from backlash_ros.drivetrain import Drive, Effects

LINKS = "Inertia: kg m^2 about the axis; the rotor at its own speed. Masses (kg) without a weight stand for nothing."
JOINTS = "damping: N m s/rad. friction: N m. effort: torque at standstill, N m. velocity: without a load, rad/s."


def ends_count_from(zero: float) -> str:
    """Return the note at the ends of an axis that does not count as its encoders do; ``zero`` in rad."""
    return (
        f"Angles are readings, as joint_states has them: limits.position_* count from zero = {zero!r} rad. A simulator "
        "begins at 0, so let it begin within these ends."
    )


def unsaid(drive: Drive) -> tuple[str, ...]:
    """Return what no format can express, a line each: properties of this drive, and those that no drive file has."""
    gear, lines = drive.gear, []
    if gear.backlash_variation:
        lines.append(
            f"* The backlash varies by {gear.backlash_variation!r} of its mean, {gear.backlash_cycles} times a turn of "
            "the output: here it is the mean everywhere."
        )
    if gear.efficiency_forward < 1.0 or gear.efficiency_backward < 1.0:
        lines.append(
            f"* The teeth let through {gear.efficiency_forward!r} of the power forward, {gear.efficiency_backward!r} "
            "backward: here all of it."
        )
    if drive.effects != Effects():
        lines.append("* The effects of real axes, effects.*: here there are none.")
    return (
        *lines,
        "* Encoders: counts, offsets, eccentricity and noise. Angles are exact here.",
        "* Delay between sample and command.",
    )


def rigid(drive: Drive) -> tuple[str, ...]:
    """Return what formats of rigid joints cannot express, a line each."""
    gear, motor = drive.gear, drive.motor
    friction = drive.load.coulomb_friction + motor.coulomb_friction / gear.ratio
    lines = (
        f"* Backlash: {gear.backlash_angle!r} rad at the output, with teeth of {gear.contact.section}. Both "
        "joints turn as one here, or each alone without mimic.",
        f"* Both sides as one joint at the output: {drive.effective_inertia:.6g} kg m^2, damping "
        f"{drive.effective_friction:.6g} N m s/rad, friction {friction:.6g} N m.",
        f"* The winding: {motor.resistance!r} ohm, {motor.inductance!r} H. The joint takes a torque, N m.",
    )
    if drive.takes_current:
        return (
            *lines,
            f"* The torque constant: a current of 1 A is {motor.torque_constant!r} N m at the motor's joint.",
        )
    back = motor.torque_constant**2 / motor.resistance
    return (
        *lines,
        f"* The torque constant and the back-EMF: 1 V is {motor.torque_constant / motor.resistance:.6g} N m at the "
        f"motor's joint, which then has {back:.6g} N m s/rad more damping than said here.",
    )
