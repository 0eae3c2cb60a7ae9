"""A drive as a controller sees it: the plant behind its sensors and its delay, sample by sample."""

import math

import numpy as np

from backlash_ros.drivetrain import Drive, IntegrationError
from backlash_ros.drivetrain.constants import PlantConstants, plant_constants
from backlash_ros.drivetrain.delay import (
    LINE,
    Delay,
    Line,
    delay_constants,
    line_of,
    player_for,
    stamped_at,
)
from backlash_ros.drivetrain.effects.views import force_view
from backlash_ros.drivetrain.motion.integrator import (
    DEFAULT_TOLERANCE,
    DONE,
    REASONS,
    integration_at,
    integration_memory,
)
from backlash_ros.drivetrain.sensors import SensorConstants, Sensors, read_sensors, sensor_constants, sensor_memory
from backlash_ros.foundation.compiled import compiled
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import Measurement, PlantState, at_rest

_IN_REAL_TIME = 10.0
"""Multiple of the standstill torque that can be simulated in real time."""


def largest_load_torque(drive: Drive) -> float:
    """Return the largest load torque, N m, that can be simulated in real time at 250 Hz: ten times the stall torque.

    Faster shafts and harder impacts take more steps. In 320 runs of 80 random drives with every contact law, each
    parameter within a factor of 3 of the nominal one, 0.1 s took at most 0.005 s of one core under this torque and
    0.008 s under ten times as much; a drive with every friction, a weight and a varying gap takes longer.
    """
    return float(f"{_IN_REAL_TIME * drive.standstill_torque():.3g}")


@compiled
def take_sample(
    sensors: SensorConstants,
    sensed: Array,
    line: Line,
    sample: int,
    out: Measurement,
) -> float:
    """Write the sample that arrives now into ``out``; return the time since the previous one, by their stamps, s."""
    delay = line.delay
    elapsed = delay.period if sample == 0 else stamped_at(delay, sample) - stamped_at(delay, sample - 1)
    read_sensors(sensors, sensed, line.taken[sample % LINE], sample, elapsed, out)
    return elapsed


class SimulatedDrive:
    """A simulated drive with sensors and delay, stepped by periods from Python.

    Parameters
    ----------
    drive, sensors, delay : parameters of the simulation
    period : of the samples, s
    seed : of noise and jitter
    state : initial state; at rest in the middle of the gap by default
    tolerance : of the integrator, per step
    """

    _sensors: SensorConstants

    def __init__(
        self,
        drive: Drive,
        period: float,
        *,
        sensors: Sensors | None = None,
        delay: Delay | None = None,
        seed: int = 0,
        state: PlantState | None = None,
        tolerance: float = DEFAULT_TOLERANCE,
    ) -> None:
        self.drive = drive
        self.state = PlantState((at_rest() if state is None else state).copy())
        self.elapsed = period
        self.measured = Measurement(np.zeros(5))
        self._sample = 0
        self._seed = seed
        self._plant: PlantConstants = plant_constants(drive)
        self._force = force_view(drive)
        self._play = player_for(drive)
        self._step = integration_memory()
        self._sensed = sensor_memory()
        self.use(sensors or Sensors())
        self._line = line_of(delay_constants(delay or Delay(), period, seed), self.state)
        self._row = np.zeros((1, 5))
        self._tolerance = tolerance

    @property
    def time(self) -> float:
        """Since the start, s."""
        return self._sample * self._line.delay.period

    @property
    def peak_force(self) -> float:
        """Largest magnitude of the contact force in the last period, N."""
        return float(integration_at(self._step).peak_force)

    @property
    def gear_torque(self) -> float:
        """Present torque of the teeth on the load, N m; no sensor shows it."""
        return self.drive.gear.load_radius * self._force(self._plant, self.state, self._step)

    @property
    def age(self) -> float:
        """Age of the sample that arrives now, by its stamp, s."""
        return self.time - stamped_at(self._line.delay, self._sample)

    def use(self, sensors: Sensors) -> None:
        """Measure with other sensors from the next sample on."""
        self._sensors = sensor_constants(sensors, self.drive.motor.torque_constant, self._seed)

    def sample(self) -> Measurement:
        """Return the sample that arrives now, which the next call overwrites; ``elapsed`` is since the previous one."""
        self.elapsed = take_sample(self._sensors, self._sensed, self._line, self._sample, self.measured)
        return self.measured

    def advance(self, command: float, load_torque: float = 0.0) -> None:
        """Send a command (V or A, limited as the drive does) and advance to the next sample.

        Raises
        ------
        ValueError
            If an input is not finite; the state is unchanged.
        IntegrationError
            If the equations cannot be integrated; the state is the last good one.
        """
        if not math.isfinite(command) or not math.isfinite(load_torque):
            raise ValueError(
                f"command ({self.drive.command_unit}) and load_torque (N m) must be finite, "
                f"got {command!r} and {load_torque!r}"
            )
        limit = self.drive.command_limit
        integration_at(self._step).peak_force = 0.0
        status, passed = self._play(
            self._plant,
            self.state,
            self._step,
            self._line,
            min(max(command, -limit), limit),
            load_torque,
            self._tolerance,
            self._row,
        )
        if status != DONE:
            raise IntegrationError(REASONS[status], self.time + passed, self.state)
        self._sample += 1
