"""What does one tick cost from Python? Beside a compiled function that takes the same arguments and does nothing.

Run with `make bench`. The tick is all that lies between a sample and its command: plausibility, limits, observer,
setpoint, range and law. The function beside it shows what numba asks for any call with these arguments.

The tick of the law of planned moves at rest and in flight, with both encoders and with either alone, and a new
reference with the tick that plans for it, are rows of docs/performance.md, beside the tick of the two-region law in the
same run, each in a loop with a simulated drive that steps to and fro. A figure is the smallest of its repeats' medians:
what else a machine does only adds to it.
"""

import time
from collections.abc import Callable

import numpy as np
import rows

from backlash_ros.control import LAWS, GainSet, Servo, ServoSettings
from backlash_ros.control.laws.planned.memory import PHASES
from backlash_ros.control.motion.trajectory import Trajectory
from backlash_ros.control.tick import TICK_SIGNATURE
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.compiled import compiled_as
from backlash_ros.foundation.signals import Measurement
from backlash_ros.simulation import SimulatedDrive

CALLS, REPEATS = 20_000, 15
PERIOD, STEPS, BETWEEN = 0.004, 40, 125
"""s; references of a loop, and samples from one to the next."""
LONGEST_TICK, LONGEST_FOLLOWING, LONGEST_PLAN = 25.0, 5.0, 5000.0
"""us"""
ENCODERS = {"": ("theta_m", "theta_l"), ", the load's encoder alone": ("theta_l",), ", the motor's alone": ("theta_m",)}
LENGTH = 4.0
"""Of a path that is followed, s."""
SAMPLE = Measurement(np.array([1.0, 0.0, 0.1, 0.0, 0.0]))
GAINS = GainSet.of(NOMINAL_DRIVE)


@compiled_as(TICK_SIGNATURE)
def nothing(_packed, _memory, _law, _state, _segments, _measured, _inputs):  # type: ignore[no-untyped-def]  # noqa: D103
    return 0.0


def servo_of(law: str, sample: Measurement = SAMPLE) -> Servo:
    """Return a servo that holds a load at rest, of a drive that it knows."""
    servo = Servo(NOMINAL_DRIVE, ServoSettings(GAINS, law=law, backlash_angle=0.02, identified=True))
    servo.update(sample, PERIOD)
    return servo


def microseconds(call: Callable[[], object]) -> float:
    """Return how long one call takes, from many."""
    start = time.perf_counter()
    for _ in range(CALLS):
        call()
    return 1e6 * (time.perf_counter() - start) / CALLS


def in_a_loop(law: str, measured: tuple[str, ...] = ENCODERS[""]) -> dict[str, float]:
    """Return the medians of ticks, us, while a simulated drive steps to and fro: "hold", "flight" and "plan"."""
    plant = SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=Sensors(measured=measured))
    servo = servo_of(law, plant.sample())
    servo.release("begins")
    taken: dict[str, list[float]] = {name: [] for name in ("hold", "flight", "plan")}
    for k in range(STEPS * BETWEEN):
        sample, comes = plant.sample(), k % BETWEEN == 1
        start = time.perf_counter()
        if comes:
            servo.set_reference(1.0 - k // BETWEEN % 2)
        command = servo.update(sample, PERIOD)
        took = 1e6 * (time.perf_counter() - start)
        taken["plan" if comes else PHASES.get(servo.shown("phase"), "hold")].append(took)
        plant.advance(command)
    assert servo.fault == ""
    return {name: float(np.median(each)) for name, each in taken.items() if each}


def planned() -> list[rows.Row]:
    """Measure the law of planned moves, in turns with the two-region law, which never flies."""
    made = list[rows.Row]()
    for alone, measured in ENCODERS.items():
        turns = [(in_a_loop("two_region"), in_a_loop("planned", measured)) for _ in range(REPEATS)]
        usual = min(plain["hold"] for plain, _ in turns)
        for name, what, longest in (
            ("hold", f"tick of law planned at rest{alone}, us", LONGEST_TICK),
            ("flight", f"tick of law planned in flight{alone}, us", LONGEST_TICK),
            ("plan", f"reference and the tick that plans for it{alone}, us", LONGEST_PLAN),
        ):
            value = min(flown[name] for _, flown in turns)
            ratios = [value / usual, *(flown[name] / plain["hold"] for plain, flown in turns)]
            made += [
                rows.Row(what, value, "tick of two_region", usual, value / usual, (min(ratios), max(ratios)), None, ""),
                rows.Row(what, value, "longest allowed", longest, value / longest, None, None, "<= 1"),
            ]
    return made


def while_following(points: int) -> float:
    """Return the median of ticks, us, while a simulated drive goes there and back along so many points."""
    servo, plant = servo_of("planned"), SimulatedDrive(NOMINAL_DRIVE, PERIOD)
    servo.release("begins")
    servo.update(plant.sample(), PERIOD)
    times = np.linspace(0.0, LENGTH, points + 1)[1:]
    phase, turn = 2.0 * np.pi * times / LENGTH, 2.0 * np.pi / LENGTH
    states = 0.5 * np.stack([1.0 - np.cos(phase), turn * np.sin(phase), turn**2 * np.cos(phase)], axis=-1)
    states[-1, 1:] = 0.0
    assert servo.follow(Trajectory(times, states), at_once=True) == ""
    taken = []
    for _ in range(round(LENGTH / PERIOD)):
        sample = plant.sample()
        start = time.perf_counter()
        command = servo.update(sample, PERIOD)
        taken.append(1e6 * (time.perf_counter() - start))
        plant.advance(command)
    assert servo.fault == ""
    return float(np.median(taken))


def followed() -> list[rows.Row]:
    """Measure the law of planned moves while it follows a thousand points, in turns with two points."""
    turns = [(while_following(2), while_following(1000)) for _ in range(REPEATS)]
    few, many = (min(each) for each in zip(*turns, strict=True))
    ratios = [many / few, *(each / other for other, each in turns)]
    what = "tick of law planned that follows 1,000 points, us"
    return [
        rows.Row(what, many, "that follows 2 points", few, many / few, (min(ratios), max(ratios)), None, ""),
        rows.Row(what, many, "longest allowed", LONGEST_FOLLOWING, many / LONGEST_FOLLOWING, None, None, "<= 1"),
    ]


def main() -> None:
    """Measure in turns and print."""
    print(f"one tick from Python, {REPEATS} times {CALLS} calls each in turn, median (smallest)")
    for law in LAWS:
        servo = servo_of(law)
        row = (servo.constants, servo.memory.row.copy(), *servo.law_arrays, servo.segments.copy(), SAMPLE, np.zeros(4))

        def tick(servo: Servo = servo) -> None:
            servo.update(SAMPLE, PERIOD)

        def bare(row: tuple[np.ndarray, ...] = row) -> None:
            nothing(*row)

        ours, reference = zip(*((microseconds(tick), microseconds(bare)) for _ in range(REPEATS)), strict=True)
        ratio = np.median(np.divide(ours, reference))
        print(
            f"  {law:16} {np.median(ours):6.2f} ({min(ours):.2f}) us   nothing {np.median(reference):6.2f} "
            f"({min(reference):.2f}) us   ratio {ratio:.1f}"
        )
        assert servo.fault == ""
    rows.record([*planned(), *followed()])


if __name__ == "__main__":
    main()
