"""A simulated drive that is stepped in time: the plant as Python callers use it."""

import math
from collections.abc import Sequence

import numpy as np

from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.effects.views import energy_view, force_view
from backlash_ros.drivetrain.motion.integrator import (
    DEFAULT_TOLERANCE,
    DONE,
    REASONS,
    IntegrationError,
    integration_memory,
    integrator_for,
)
from backlash_ros.drivetrain.parameters import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, LOST, OMEGA_L, OMEGA_M, SUPPLIED, THETA_L, THETA_M, PlantState


class Plant:
    """The geared servo with its state, advanced under a constant command and load torque.

    Parameters
    ----------
    drive : the parameters
    state : theta_m, omega_m, theta_l, omega_l, i; at rest in the middle of the gap by default
    tolerance : of the integrator, per step
    account : whether to integrate the energies supplied and lost

    Examples
    --------
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> plant = Plant(NOMINAL_DRIVE)
    >>> plant.advance(command=1.0, load_torque=0.0, duration=0.1)
    >>> print(f"{plant.load_angle:.4f} rad after {plant.time:.1f} s")
    0.1457 rad after 0.1 s
    """

    def __init__(
        self,
        drive: Drive,
        state: Sequence[float] | None = None,
        tolerance: float = DEFAULT_TOLERANCE,
        *,
        account: bool = False,
    ) -> None:
        self.drive = drive
        self.time = 0.0
        self._constants = plant_constants(drive)
        self._energy, self._force = energy_view(drive), force_view(drive)
        self._advance = integrator_for(drive, account=account)
        motion = np.zeros(5) if state is None else np.array(state, dtype=float)
        if motion.shape != (5,) or not np.all(np.isfinite(motion)):
            raise ValueError(f"state must be five finite numbers, got {state!r}")
        self._state = PlantState(np.append(motion, [0.0, 0.0]))
        self._step = integration_memory(account=account)
        self._account = account
        self._tolerance = tolerance

    def advance(self, command: float, load_torque: float, duration: float) -> None:
        """Advance by ``duration`` seconds; the command (V or A, as the drive takes it) is limited as the drive does.

        Raises
        ------
        ValueError
            If an input is not finite or the duration is negative; the state is unchanged.
        IntegrationError
            If the equations cannot be integrated; the state is the last good one.
        """
        for name, value, unit in (("command", command, self.drive.command_unit), ("load_torque", load_torque, "N m")):
            if not math.isfinite(value):
                raise ValueError(f"{name} must be finite, in {unit}, got {value!r}")
        if not 0 <= duration < math.inf:
            raise ValueError(f"duration must be >= 0 s and finite, got {duration!r}")
        limit = self.drive.command_limit
        limited = min(max(command, -limit), limit)
        status, passed = self._advance(
            self._constants, self._state, self._step, limited, load_torque, duration, self._tolerance
        )
        self.time += passed
        if status != DONE:
            raise IntegrationError(REASONS[status], self.time, self._state)

    @property
    def state(self) -> Array:
        """A copy of the state, shape (5,), in the order of `signals.STATE_NAMES`."""
        return self._state[:5].copy()

    @property
    def motor_angle(self) -> float:
        """theta_m, rad."""
        return float(self._state[THETA_M])

    @property
    def motor_speed(self) -> float:
        """omega_m, rad/s."""
        return float(self._state[OMEGA_M])

    @property
    def motor_torque(self) -> float:
        """K_m i, N m."""
        return self.drive.motor.torque_constant * float(self._state[CURRENT])

    @property
    def load_angle(self) -> float:
        """theta_l, rad."""
        return float(self._state[THETA_L])

    @property
    def load_speed(self) -> float:
        """omega_l, rad/s."""
        return float(self._state[OMEGA_L])

    @property
    def energy_stored(self) -> float:
        """Kinetic, magnetic, elastic and potential energy, J; no magnetic one where the current is imposed."""
        return self._energy(self._constants, self._state, self._step)

    @property
    def energy_supplied(self) -> float:
        """Work at the motor's terminals and of the load torque since the start, J; RuntimeError without an account."""
        return self._accounted(SUPPLIED)

    @property
    def energy_lost(self) -> float:
        """Heat of winding, friction and contact since the start, J; RuntimeError without an account."""
        return self._accounted(LOST)

    def _accounted(self, energy: int) -> float:
        if not self._account:
            raise RuntimeError("energies are integrated where they are asked for: Plant(..., account=True)")
        return float(self._state[energy])

    @property
    def gear_torque(self) -> float:
        """Torque R2 F that the teeth put on the load, N m."""
        return self.drive.gear.load_radius * self._force(self._constants, self._state, self._step)
