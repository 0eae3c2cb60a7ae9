"""The drive a second time, for tests: plain Python and scipy's events between the modes of dry friction."""

import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from backlash_ros.drivetrain import Drive


class Reference:
    """A drive with power contact under a constant voltage and load torque, piece after piece.

    ``events`` lists what friction did: shaft ("motor", "load") and its new mode, 1, -1 or 0.
    """

    def __init__(self, drive: Drive, state: list[float]) -> None:
        self.drive, self.x = drive, np.array(state)
        self.events: list[tuple[str, int]] = []
        self.time = 0.0

    def half_gap(self, theta_l: float) -> tuple[float, float]:
        gear = self.drive.gear
        mean, angle = gear.backlash / 2, gear.backlash_cycles * theta_l + gear.backlash_phase
        slope = -mean * gear.backlash_variation * gear.backlash_cycles * math.sin(angle)
        return mean * (1 + gear.backlash_variation * math.cos(angle)), slope

    def loads(self, x: np.ndarray, torque: float) -> tuple[float, float, tuple[float, float]]:
        """What acts on the motor without its gear, on the load, and what the gear puts on the motor at either slip."""
        motor, gear, load, teeth = self.drive.motor, self.drive.gear, self.drive.load, self.drive.gear.contact
        assert type(teeth).__name__ == "PowerContact"
        beta, alpha, n = teeth.stiffness, teeth.damping, teeth.exponent  # type: ignore[attr-defined]
        half, slope = self.half_gap(x[2])
        s = (gear.motor_radius * x[0] - gear.load_radius * x[2]) / half
        force = beta * s**n + alpha * (gear.motor_radius * x[1] - gear.load_radius * x[3]) * s ** (n + 1)
        # U = beta g^(n+1) h^-n/(n+1)
        narrowing = -n * beta / (n + 1) * s ** (n + 1) * slope
        weight = load.gravity_torque * math.sin(x[2] + load.gravity_offset)
        on_motor = motor.torque_constant * x[4] - motor.viscous_friction * x[1]
        on_load = gear.load_radius * force - load.viscous_friction * x[3] - weight - narrowing + torque
        teeth_torque = gear.motor_radius * force
        out_of, into = teeth_torque / gear.efficiency_forward, teeth_torque * gear.efficiency_backward
        forward = (out_of if force > 0 else into) + motor.coulomb_friction
        backward = (into if force > 0 else out_of) - motor.coulomb_friction
        return on_motor, on_load, (forward, backward)

    def slope(self, x: np.ndarray, voltage: float, torque: float, mode_m: int, mode_l: int) -> list[float]:
        motor, load = self.drive.motor, self.drive.load
        on_motor, on_load, (forward, backward) = self.loads(x, torque)
        rise = (voltage - motor.resistance * x[4] - motor.torque_constant * x[1]) / motor.inductance
        fast = (on_motor - (forward if mode_m > 0 else backward)) / motor.inertia if mode_m else 0.0
        turn = (on_load - mode_l * load.coulomb_friction) / load.inertia if mode_l else 0.0
        return [x[1], fast, x[3], turn, rise]

    def at_rest(self, torque: float) -> tuple[int, int]:
        """The modes that either shaft takes when it stands."""
        on_motor, on_load, (forward, backward) = self.loads(self.x, torque)
        limit = self.drive.load.coulomb_friction
        mode_m = 1 if on_motor > forward else -1 if on_motor < backward else 0
        return mode_m, 1 if on_load > limit else -1 if on_load < -limit else 0

    def advance(self, voltage: float, torque: float, duration: float, rtol: float = 1e-11) -> None:
        rest = self.at_rest(torque)
        mode_m, mode_l = (int(np.sign(self.x[k])) or rest[k // 2] for k in (1, 3))
        passed, limit = 0.0, self.drive.load.coulomb_friction
        while passed < duration:
            events: list[Any] = []

            def add(name: str, function: Any, direction: float, to: list[Any] = events) -> None:
                function.terminal, function.direction, function.name = True, direction, name
                to.append(function)

            if mode_m:
                add("motor", lambda _t, x: x[1], -mode_m)
            else:
                add("motor", lambda _t, x: self.loads(x, torque)[0] - self.loads(x, torque)[2][0], 1)
                add("motor", lambda _t, x: self.loads(x, torque)[2][1] - self.loads(x, torque)[0], 1)
            if mode_l:
                add("load", lambda _t, x: x[3], -mode_l)
            else:
                add("load", lambda _t, x: abs(self.loads(x, torque)[1]) - limit, 1)
            found = solve_ivp(
                lambda _t, x, m=mode_m, n=mode_l: self.slope(x, voltage, torque, m, n),
                (passed, duration),
                self.x,
                "Radau" if rtol > 1e-9 else "LSODA",
                events=events,
                rtol=rtol,
                atol=1e-14,
                max_step=(duration - passed) / 4,
            )
            assert found.success
            self.x, passed = found.y[:, -1], found.t[-1]
            if found.status != 1:
                break
            for event, times in zip(events, found.t_events, strict=True):
                if times.size and event.name == "motor":
                    was, mode_m = mode_m, self._stop(1, torque)[0] if mode_m else self._way(torque)[0]
                    self.events += [("motor", mode_m)] * (was != mode_m)
                elif times.size:
                    was, mode_l = mode_l, self._stop(3, torque)[1] if mode_l else self._way(torque)[1]
                    self.events += [("load", mode_l)] * (was != mode_l)
        self.time += duration

    def _stop(self, k: int, torque: float) -> tuple[int, int]:
        self.x[k] = 0.0
        return self.at_rest(torque)

    def _way(self, torque: float) -> tuple[int, int]:
        """The modes of shafts that break away, which they do in the direction in which they are pushed."""
        on_motor, on_load, (forward, backward) = self.loads(self.x, torque)
        return (1 if on_motor - forward > backward - on_motor else -1), (1 if on_load > 0 else -1)
