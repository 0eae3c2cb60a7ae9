"""How fast is the offline closed loop? Against scipy's LSODA on the same loop, and against the clock.

Run with `make bench`. Both integrate the nominal step response with the fast gains, limit cycle included, sampled at
1 kHz, in the same process and in turn; the ratio is what holds on another machine. The accuracy of each is shown beside
it, as the largest difference of the load angle to a run with a far tighter tolerance.
"""

import time
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

from backlash_ros.control import GainSet, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.motion.dynamics import Acting, equations_of
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, THETA_L
from backlash_ros.simulation import Scenario, run

PERIOD, COUNT, REPEATS = 0.001, 500, 5
GAINS = GainSet.of(NOMINAL_DRIVE)
SETTINGS = ServoSettings(GAINS, law="fast", period=PERIOD)
SCENARIO = Scenario(np.ones(COUNT), known_load_torque=True)


def ours(tolerance: float = 1e-9) -> np.ndarray:
    """Run the package's closed loop; return the load angle at every sample."""
    return run(NOMINAL_DRIVE, SETTINGS, SCENARIO, tolerance).load_angle


def scipys() -> np.ndarray:
    """Run the same loop with scipy's LSODA on the package's compiled equations of motion."""
    plant, gains, limit = plant_constants(NOMINAL_DRIVE), GAINS.fast.as_array(), NOMINAL_DRIVE.motor.voltage_limit
    derivative, slope, full = equations_of(NOMINAL_DRIVE).derivative, np.empty(7), np.zeros(7)

    def equations(_t: float, state: np.ndarray, voltage: float) -> np.ndarray:
        full[:5] = state
        derivative(plant, full, Acting(voltage, 0.0), slope)
        return slope[:5]

    state, angles = np.zeros(5), [0.0]
    for _ in range(COUNT):
        voltage = float(-gains @ (state[[THETA_L, OMEGA_L, CURRENT]] - [1.0, 0.0, 0.0]))
        held = (min(max(voltage, -limit), limit),)
        state = solve_ivp(equations, (0, PERIOD), state, "LSODA", args=held, rtol=1e-9, atol=1e-12).y[:, -1]
        angles.append(state[THETA_L])
    return np.array(angles)


def seconds(function: Callable[[], np.ndarray]) -> float:
    """Return how long one call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> None:
    """Measure and print."""
    exact = ours(1e-13)
    errors = [float(np.max(np.abs(function() - exact))) for function in (ours, scipys)]  # compiles, too
    pairs = [(seconds(ours), seconds(scipys)) for _ in range(REPEATS)]
    mine, theirs = np.median(pairs, axis=0)
    simulated = PERIOD * COUNT
    print(f"{simulated:g} s of closed loop, {REPEATS} runs each in turn, median")
    print(f"  backlash_ros   {mine:8.4f} s   {simulated / mine:8.1f} x real time   error {errors[0]:.1e} rad")
    print(f"  scipy LSODA    {theirs:8.4f} s   {simulated / theirs:8.1f} x real time   error {errors[1]:.1e} rad")
    print(f"  ratio          {np.median([b / a for a, b in pairs]):8.1f}")


if __name__ == "__main__":
    main()
