"""Ours and MuJoCo play the same drives of the population: free flight, rigid motion, gravity and friction.

What they share is the drive's parameters; `mujoco_drive` makes a model of them, with a weight on an arm for gravity.
Both are integrated so finely (RK4 with 50 us there, where a drive's own times are milliseconds: errors of (1e-2)^4 of
the motion and less) that 1e-6 of the motion is left for it. Beyond it a test allows what it derives where it stands:
the give of two different contacts, or the steps in which MuJoCo stops a shaft that rubs.

Where teeth should not touch, the gap stays below 0.3 of its half: there the power contact has 0.3^21 = 1e-11 of its
force. Gaps do not vary here and the current is imposed: see `mujoco_drive`.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from backlash_ros.drivetrain import Drive, Plant
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.studies.evaluation.population import draw_member

if find_spec("mujoco") is None:
    pytest.skip("MuJoCo is not installed here; the locks in requirements have it", allow_module_level=True)

from mujoco_drive import STEP, MujocoDrive, friction_creep, limit_give

SEED = 20090
INTEGRATORS = 1e-6
"""Share of the motion that both integrators together may miss."""
SAMPLE = 20
"""Steps from one comparison to the next: 1 ms."""
WIDE = 3.2
"""A gap in which each shaft moves on its own, rad."""


def ten(wanted: Callable[[Drive], bool] = lambda _: True) -> list[Drive]:
    """The first ten drives of the population that are wanted."""
    found: list[Drive] = []
    number = 0
    while len(found) < 10:
        drive = draw_member(SEED, number).drive
        number += 1
        if wanted(drive):
            found.append(replace(drive, gear=replace(drive.gear, backlash_variation=0.0), command_interface="current"))
    return found


def weighted(drive: Drive) -> bool:
    return drive.load.gravity_torque > 0.0


def rubs(drive: Drive) -> bool:
    return drive.load.coulomb_friction > 0.0 and drive.motor.coulomb_friction > 0.0


def without_friction(drive: Drive) -> Drive:
    """The drive without dry friction."""
    return replace(
        drive, motor=replace(drive.motor, coulomb_friction=0.0), load=replace(drive.load, coulomb_friction=0.0)
    )


def in_a_wide_gap(drive: Drive) -> Drive:
    return replace(drive, gear=replace(drive.gear, backlash_angle=WIDE))


def both(drive: Drive, start: list[float], theirs: list[float] | None = None) -> tuple[Plant, MujocoDrive]:
    """The drive in both simulators: ours started at theta_m, omega_m, theta_l, omega_l; theirs there by default."""
    return Plant(drive, [*start, 0.0], tolerance=1e-11), MujocoDrive(drive, theirs or start)


def step(ours: Plant, theirs: MujocoDrive, current: float, load_torque: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Both states one sample on, the motor's angle and speed as at the output."""
    ours.advance(current, load_torque, SAMPLE * STEP)
    theirs.advance(current, load_torque, SAMPLE)
    at_output = np.array([ours.drive.gear.ratio] * 2 + [1.0] * 2)
    return at_output * ours.state[:4], at_output * theirs.state


def coulomb_torques(drive: Drive) -> tuple[float, float]:
    """Coulomb friction of motor and load, N m at the output."""
    return drive.motor.coulomb_friction / drive.gear.ratio, drive.load.coulomb_friction


def motor_viscous(drive: Drive) -> float:
    """The motor's viscous friction at the output, N m s/rad."""
    return drive.motor.viscous_friction / drive.gear.ratio**2


def per_output(drive: Drive) -> float:
    """Motor current for each newton metre at the output, A/(N m)."""
    return drive.gear.ratio / drive.motor.torque_constant


@pytest.mark.corners(3)
@pytest.mark.parametrize("drive", ten(), ids=range(10))
def test_free_flight(drive: Drive) -> None:
    """Both shafts at 10 rad/s, the motor braked like the load at first, so that they fly long within the gap."""
    n, load, speed = drive.gear.ratio, drive.load, 10.0
    rubbed_m, rubbed_l = coulomb_torques(drive)
    weight = load.gravity_torque * math.sin(load.gravity_offset)
    slowing = (load.viscous_friction * speed + rubbed_l + weight) / load.inertia
    torque = motor_viscous(drive) * speed + rubbed_m - drive.reflected_inertia * slowing
    ours, theirs = both(drive, [0.0, speed / n, 0.0, speed])
    flown = 0
    while flown < 50:
        a, b = step(ours, theirs, per_output(drive) * torque)
        if abs(b[0] - b[2]) > 0.3 * drive.gear.backlash_angle / 2 or min(b[1], b[3]) < 0.5:
            break
        flown += 1
        np.testing.assert_allclose(a, b, rtol=INTEGRATORS)
    assert flown >= 3


def static_gap(drive: Drive, torque: float) -> float:
    """Gap in which our teeth carry a torque on the output, rad, by algebra from the law's own parameters."""
    gear, teeth = drive.gear, drive.gear.contact
    half = 0.5 * gear.backlash_angle
    if isinstance(teeth, PowerContact):
        return half * (torque / (teeth.stiffness * gear.load_radius)) ** (1.0 / teeth.exponent)
    assert isinstance(teeth, ElasticContact)
    return half + torque * teeth.wind_up


def on_a_flank(
    drive: Drive, torque: float, teeth: tuple[float, float, float], start: tuple[float, float], samples: int
) -> None:
    """Compare a motion with the teeth on one flank.

    Parameters
    ----------
    torque : of the motor at the output, N m
    teeth : the torque that they carry at first, and the least and the most of it later while they do not give, N m;
        a spring loaded at once gives twice as much, so that half the least and twice the most are allowed, and checked
    start : angle and speed of the centre x = (J_r n theta_m + J_l theta_l)/J_e, rad and rad/s

    The gap g, and with it the contact, moves x only by what the shafts' own friction and the weight make of it:

        J_e x'' = T - B_e x' - (B_r J_l - B_l J_r)/J_e g' - G sin(x - J_r/J_e g + offset) - Coulomb friction

    So with gaps that differ by D at most, after a time t the speeds of x differ by
    (2 abs(B_r J_l - B_l J_r)/J_e D + G J_r/J_e D t)/J_e at most, as integrals of g' and g, and x by t times as much:
    B_e and the weight, less than a quarter of a turn from where it hangs, make such a difference no larger. D is the
    range of static gaps for the tooth torques that are allowed, of ours and of theirs together.
    """
    gear, load = drive.gear, drive.load
    share_m, J_e = drive.motor_share, drive.effective_inertia
    first, low, high = teeth[0], teeth[1] / 2, teeth[2] * 2
    ours_low, ours_high = static_gap(drive, low), static_gap(drive, high)
    edge = 0.5 * gear.backlash_angle
    theirs_high = edge + limit_give(drive, high)
    D = max(abs(ours_high - edge), abs(theirs_high - ours_low))

    def at(gap: float) -> list[float]:
        x, speed = start
        return [(x + (1.0 - share_m) * gap) / gear.ratio, speed / gear.ratio, x - share_m * gap, speed]

    starts = at(static_gap(drive, first)), at(edge + limit_give(drive, first))
    ours, theirs = both(drive, *starts)
    swap = 2.0 * abs(motor_viscous(drive) * load.inertia - load.viscous_friction * drive.reflected_inertia) / J_e * D
    fastest = 0.0
    for sample in range(1, samples + 1):
        a, b = step(ours, theirs, per_output(drive) * torque)
        assert low < ours.gear_torque < high
        assert ours_low <= a[0] - a[2] <= ours_high
        assert edge <= b[0] - b[2] <= theirs_high
        x, y = (share_m * s[:2] + (1.0 - share_m) * s[2:] for s in (a, b))
        time = sample * SAMPLE * STEP
        speed = (swap + load.gravity_torque * share_m * D * time) / J_e
        fastest = max(fastest, abs(y[1]))
        speed += INTEGRATORS * fastest
        assert abs(x[1] - y[1]) <= speed
        assert abs(x[0] - y[0]) <= speed * time
        assert abs(a[0] - b[0]) <= speed * time + (1.0 - share_m) * D
        assert abs(a[2] - b[2]) <= speed * time + share_m * D


@pytest.mark.corners(3)
@pytest.mark.parametrize("drive", ten(), ids=range(10))
def test_rigid_motion(drive: Drive) -> None:
    """From where the weight hangs 0.9 rad forward under a constant torque that is 1.5 times what resists."""
    load, speed, way = drive.load, 1.0, 0.9
    rubbed, J_e = sum(coulomb_torques(drive)), drive.effective_inertia
    torque = 1.5 * (load.gravity_torque + rubbed) + 0.3
    acceleration = (torque - rubbed - drive.effective_friction * speed) / J_e
    fastest = math.sqrt(speed**2 + 2.0 * acceleration * way)
    weight = load.gravity_torque * math.sin(way)
    slowest = max(0.0, torque - rubbed - weight - drive.effective_friction * fastest) / J_e
    teeth = (
        load.inertia * acceleration + load.coulomb_friction + load.viscous_friction * speed,
        load.inertia * slowest + load.coulomb_friction + load.viscous_friction * speed,
        load.inertia * acceleration + load.coulomb_friction + load.viscous_friction * fastest + weight,
    )
    samples = int((fastest - speed) / acceleration / (SAMPLE * STEP))
    on_a_flank(drive, torque, teeth, (-load.gravity_offset, speed), samples)


@pytest.mark.corners(3)
@pytest.mark.parametrize("drive", ten(weighted), ids=range(10))
def test_gravity_on_a_flank(drive: Drive) -> None:
    """The motor holds the weight 0.6 rad from where it hangs, and it swings 0.1 rad about that: a period, or 1 s."""
    drive = without_friction(drive)
    load = drive.load
    hold, swing = 0.6, 0.1
    torque = load.gravity_torque * math.sin(hold)
    swinging = [load.gravity_torque * (math.sin(hold + s) - math.sin(hold)) for s in (swing, -swing)]
    back, forth = (torque + drive.motor_share * s for s in swinging)
    period = 2.0 * math.pi * math.sqrt(drive.effective_inertia / (load.gravity_torque * math.cos(hold)))
    start = hold + swing - load.gravity_offset + drive.motor_share * 0.5 * drive.gear.backlash_angle
    on_a_flank(drive, torque, (back, forth, back), (start, 0.0), int(min(period, 1.0) / (SAMPLE * STEP)))


@pytest.mark.corners(3)
@pytest.mark.parametrize("drive", ten(weighted), ids=range(10))
def test_gravity_alone(drive: Drive) -> None:
    """The weight swings 0.4 rad from where it hangs, in a wide gap, a second long."""
    drive = in_a_wide_gap(without_friction(drive))
    hanging = -drive.load.gravity_offset
    ours, theirs = both(drive, [hanging / drive.gear.ratio, 0.0, hanging + 0.4, 0.0])
    speeds = []
    for _ in range(1000):
        a, b = step(ours, theirs, 0.0)
        speeds.append(abs(b[3]))
        assert abs(a[2] - b[2]) <= INTEGRATORS * 0.4
        assert abs(a[3] - b[3]) <= INTEGRATORS * max(speeds)
        assert abs(a[0] - b[0]) <= INTEGRATORS * 0.4


@pytest.mark.corners(4)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["forward", "backward"])
@pytest.mark.parametrize("drive", ten(rubs), ids=range(10))
def test_friction_stops_the_shafts(drive: Drive, sign: float) -> None:
    """Each shaft coasts on its own, at most 0.4 rad: the same way and the same time.

    MuJoCo's friction fades below the speed that it takes away in one time constant, 2 steps: a h with its time constant
    b = 1/h, a the deceleration and h the step. It stops by exp(-t/h) from there: a h late in speed, a h^2 in way. A
    step that begins before and ends after that point may miss as much again, and so may the start of the next one: 3 a
    h, and so 3 h in the time of the stop.
    """
    drive = in_a_wide_gap(replace(drive, load=replace(drive.load, gravity_torque=0.0)))
    slowing = np.array(coulomb_torques(drive)) / [drive.reflected_inertia, drive.load.inertia]
    start = sign * np.sqrt(2.0 * slowing * 0.4)
    ours, theirs = both(drive, [0.0, start[0] / drive.gear.ratio, 0.0, start[1]])
    for _ in range(math.ceil(max(np.abs(start) / slowing) / (SAMPLE * STEP)) + 2):
        a, b = step(ours, theirs, 0.0)
        assert np.all(np.abs(a[1::2] - b[1::2]) <= 3.0 * slowing * STEP + INTEGRATORS * np.abs(start))
        assert np.all(np.abs(a[0::2] - b[0::2]) <= 3.0 * slowing * STEP**2 + INTEGRATORS * 0.4)
    assert np.all(a[1::2] == 0.0)
    assert np.all(sign * a[0::2] > 0.0)


@pytest.mark.corners(4)
@pytest.mark.parametrize("sign", [1.0, -1.0], ids=["forward", "backward"])
@pytest.mark.parametrize("drive", ten(rubs), ids=range(10))
def test_friction_holds_and_breaks_away(drive: Drive, sign: float) -> None:
    """Within 1 % below the Coulomb friction a shaft stays; 1 % above it goes, by that 1 %."""
    drive = in_a_wide_gap(replace(drive, load=replace(drive.load, gravity_torque=0.0)))
    torque = sign * np.array(coulomb_torques(drive))
    inertia = np.array([drive.reflected_inertia, drive.load.inertia])
    seconds = 20 * SAMPLE * STEP
    for share in (0.99, 1.01):
        ours, theirs = both(drive, [0.0] * 4)
        for _ in range(20):
            a, b = step(ours, theirs, per_output(drive) * share * torque[0], share * torque[1])
        if share < 1.0:
            assert np.all(a == 0.0)
            creep = [friction_creep(abs(t), J) for t, J in zip(torque, inertia, strict=True)]
            assert np.all(np.abs(b[0::2]) <= np.array(creep) * seconds)
            assert np.all(np.abs(b[1::2]) <= np.array(creep))
        else:
            assert np.all(sign * a > 0.0)
            np.testing.assert_allclose(a, b, rtol=INTEGRATORS)
