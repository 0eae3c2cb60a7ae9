"""What does one tick cost from Python? Beside a compiled function that takes the same arguments and does nothing.

Run with `make bench`. The tick is all that lies between a sample and its command: plausibility, limits, observer,
setpoint, range and law. The function beside it shows what numba asks for any call with these arguments.
"""

import time
from collections.abc import Callable

import numpy as np

from backlash_ros.control import DEFAULT_WEIGHTS, LAWS, GainSet, Servo, ServoSettings, design_gains
from backlash_ros.control.tick import TICK_SIGNATURE
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.compiled import compiled_as
from backlash_ros.drivetrain.signals import Measurement

CALLS, REPEATS = 20_000, 15
SAMPLE = Measurement(np.array([1.0, 0.0, 0.1, 0.0, 0.0]))
GAINS = GainSet(**{region: design_gains(region, NOMINAL_DRIVE, weights) for region, weights in DEFAULT_WEIGHTS.items()})


@compiled_as(TICK_SIGNATURE)
def nothing(_packed, _memory, _law, _state, _segments, _measured, _inputs):  # type: ignore[no-untyped-def]  # noqa: D103
    return 0.0


def microseconds(call: Callable[[], object]) -> float:
    """Return how long one call takes, from many."""
    start = time.perf_counter()
    for _ in range(CALLS):
        call()
    return 1e6 * (time.perf_counter() - start) / CALLS


def main() -> None:
    """Measure in turns and print."""
    print(f"one tick from Python, {REPEATS} times {CALLS} calls each in turn, median (smallest)")
    for law in LAWS:
        servo = Servo(NOMINAL_DRIVE, ServoSettings(GAINS, law=law, backlash_angle=0.02))
        row = (servo.constants, servo.memory.row.copy(), *servo.law_arrays, servo.segments.copy(), SAMPLE, np.zeros(4))

        def tick(servo: Servo = servo) -> None:
            servo.update(SAMPLE, 0.004)

        def bare(row: tuple[np.ndarray, ...] = row) -> None:
            nothing(*row)

        tick()
        ours, reference = zip(*((microseconds(tick), microseconds(bare)) for _ in range(REPEATS)), strict=True)
        ratio = np.median(np.divide(ours, reference))
        print(
            f"  {law:16} {np.median(ours):6.2f} ({min(ours):.2f}) us   nothing {np.median(reference):6.2f} "
            f"({min(reference):.2f}) us   ratio {ratio:.1f}"
        )
        assert servo.fault == ""


if __name__ == "__main__":
    main()
