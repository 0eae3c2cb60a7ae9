"""The pictures of docs/law.md, of the law of planned moves: a flight, its landing, and a load torque in hold."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from backlash_ros.control import Servo, ServoSettings
from backlash_ros.control.laws.planned.memory import FLIGHT, Memory, memory_at
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.foundation.staging import staging
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.paper import PERIOD, gains

_B = NOMINAL_DRIVE.gear.backlash_angle
_ENCODERS = Sensors(measured=POSITIONS, motor_counts=2.0**12, load_counts=2.0**16)
_STEP, _TORQUE = 1.0, -0.2
"""Step of the reference, rad, and load torque while holding, N m."""
_MOVES, _SETTLED, _ENDS = 0.05, 1.0, 1.65
"""Times of the step, the load torque and the end, s."""
_TOUCHED = 1e-4
"""Torque of the teeth, N m, beyond which a flank is drawn as touching the load."""
_NAMED = 0.035
"""Least share of a picture's width for a span to be named."""
_MOTOR: dict[str, Any] = {"color": "C0", "linewidth": 1.8}
_LOAD: dict[str, Any] = {"color": "black", "linewidth": 1.8}
_TEETH: dict[str, Any] = {"color": "black", "linewidth": 1.4}
_PLANNED: dict[str, Any] = {"color": "C1", "linewidth": 1.6, "linestyle": "--"}
_COMPENSATED: dict[str, Any] = {"color": "C0", "linewidth": 1.6, "linestyle": "-."}

Span = tuple[float, float, str]
"""From, to, s, and what the law does meanwhile."""


@dataclass(frozen=True)
class Trace:
    """What moved, sample by sample, shape (N,), and the law's memory at each.

    ``motor`` and ``load``: p and theta_l, rad; ``teeth`` and ``load_torque``: N m at the output.
    """

    time: Array
    motor: Array
    load: Array
    teeth: Array
    load_torque: Array
    memories: Sequence[Memory]


def trace() -> Trace:
    """Simulate the nominal drive, as identified: a step, and a load torque once the load is at rest."""
    settings = ServoSettings(gains(), period=PERIOD, backlash_angle=_B, identified=True).with_law("planned")
    servo, drive = Servo(NOMINAL_DRIVE, settings), SimulatedDrive(NOMINAL_DRIVE, PERIOD, sensors=_ENCODERS)
    rows, memories = [], []
    for k in range(round(_ENDS / PERIOD)):
        torque = _TORQUE if k >= round(_SETTLED / PERIOD) else 0.0
        if k == round(_MOVES / PERIOD):
            servo.set_reference(_STEP)
        command = servo.update(drive.sample())
        motor, load = NOMINAL_DRIVE.gear.ratio * drive.state[THETA_M], drive.state[THETA_L]
        rows.append((k * PERIOD, motor, load, drive.gear_torque, torque))
        memories.append(memory_at(servo.law_arrays[1].copy()))
        drive.advance(command, torque)
    time, motor, load, teeth, load_torque = np.ascontiguousarray(np.array(rows).T)
    return Trace(time, motor, load, teeth, load_torque, memories)


def _panels(ratios: Sequence[float], title: str, *, lines: int = 1) -> tuple[Figure, list[Axes]]:
    """Return a figure with panels below each other, with room above for spans named in so many ``lines``."""
    size = (8.0, 1.3 + sum(ratios))
    figure, panels = plt.subplots(
        len(ratios), 1, figsize=size, sharex=True, constrained_layout=True, height_ratios=ratios
    )
    panels[0].set_title(title, loc="left", pad=10 + 14 * lines)
    return figure, list(panels)


def _shade(panels: Sequence[Axes], spans: Sequence[Span]) -> None:
    """Shade every other span in all panels, and name the spans above the first one that are wide enough for it."""
    least = _NAMED * (spans[-1][1] - spans[0][0])
    for k, (start, end, name) in enumerate(spans):
        for axes in panels:
            axes.axvspan(start, end, color="C2" if k % 2 == 0 else "white", alpha=0.12, zorder=0, linewidth=0)
        at = panels[0].get_xaxis_transform()
        if end - start >= least:
            panels[0].text(0.5 * (start + end), 1.02, name, transform=at, ha="center", va="bottom")


def _near(axes: Axes, time: Array, done: Trace) -> None:
    """Draw the gap that the load carries with it, from the target, and the motor in it."""
    load, motor = (done.load - _STEP) / _B, (done.motor - _STEP) / _B
    axes.fill_between(time, load - 0.5, load + 0.5, color="0.85", zorder=1, label="gap", linewidth=0)
    axes.plot(time, load, label="load", **_LOAD)
    axes.plot(time, motor, label="motor", **_MOTOR)
    axes.axhline(0.0, color="black", linewidth=0.8, linestyle=":")
    axes.set_ylabel("from the target, b")
    axes.legend(loc="lower right", fontsize="small")


def _named(memory: Memory, teeth: float, *, flanks: bool) -> str:
    """Return what the law does, in the page's words; ``teeth``: their torque, N m.

    ``flanks``: with the flank that leads a free load, and whether the motor is still on its way to it.
    """
    flank, parked = memory.flank, memory.hold.parking_time >= 0.0
    if memory.phase == FLIGHT:
        return "flight"
    if memory.held != 0.0:
        return "held: parked" if parked else "held: led in"
    if parked:
        return "parked"
    if not flanks:
        return "free: led in"
    if flank == 0.0:
        return "wait"
    leads = "pushes" if flank > 0.0 else "slows"
    return f"flank {flank:g}\n{leads}" if teeth * flank > _TOUCHED else f"motor to\nflank {flank:g}"


def _spans(done: Trace, start: float, end: float, zero: float, *, flanks: bool) -> list[Span]:
    """Return what the law does from ``start`` to ``end``, s; the times in the result count from ``zero``."""
    shown = np.flatnonzero((done.time >= start) & (done.time <= end))
    groups = groupby(shown.tolist(), lambda k: _named(done.memories[k], float(done.teeth[k]), flanks=flanks))
    first = [(float(done.time[next(samples)]) - zero, name) for name, samples in groups]
    ends = [*(moment for moment, _ in first[1:]), end - zero]
    return [(moment, until, name) for (moment, name), until in zip(first, ends, strict=True)]


def flight(done: Trace) -> Figure:
    """Draw a move: the load, the motor in the gap, and the torque of the teeth."""
    figure, panels = _panels((1.3, 1.7, 1.7), "Flight: the load is thrown, and braked at its target")
    whole, gap, teeth = panels
    time, most = done.time - _MOVES, 0.2
    plan = next(memory.plan for memory in done.memories if memory.phase == FLIGHT)
    ends = np.cumsum([segment.duration for segment in plan.segments[: int(plan.segment_count)]])
    moments = [0.0, *ends.tolist(), most]
    names = "approach", "push", "cross", "brake", "leave", "hold"
    _shade(panels, [*zip(moments[:-1], moments[1:], names, strict=True)])
    whole.plot(time, done.load, **_LOAD)
    whole.axhline(_STEP, color="black", linewidth=0.8, linestyle=":")
    whole.set(ylabel="load, rad", ylim=(-0.1, 1.15))
    gap.plot(time, (done.motor - done.load) / _B, **_MOTOR)
    for flank, words in ((1, "flank 1 drives the load forward"), (-1, "flank -1 holds it back")):
        gap.axhspan(0.5 * flank, 0.75 * flank, color="0.85", zorder=1, linewidth=0)
        gap.text(0.98 * most, 0.62 * flank, words, ha="right", va="center", fontsize="small")
    gap.set(ylabel="g / b", ylim=(-0.75, 0.75), yticks=(-0.5, 0.0, 0.5))
    teeth.plot(time, done.teeth, label="torque of the teeth", **_TEETH)
    carried = [float(memory.sent.teeth_torques[0]) for memory in done.memories]
    teeth.plot(time, carried, label="as planned", **_PLANNED)
    teeth.set(ylabel="on the load, N m", ylim=(-0.25, 0.65))
    teeth.set(xlabel="time after the step, s", xlim=(-0.015, most))
    teeth.legend(loc="upper right", fontsize="small")
    return figure


def landing(done: Trace) -> Figure:
    """Draw the end of the move: the motor in the gap near the target, and the torque of the teeth."""
    figure, panels = _panels((3.2, 1.5), "Landing: what is left is taken up with one flank at a time", lines=2)
    gap, teeth = panels
    time, least, most = done.time - _MOVES, 0.065, 0.75
    _shade(panels, _spans(done, _MOVES + least, _MOVES + most, _MOVES, flanks=True))
    _near(gap, time, done)
    gap.set(ylim=(-1.1, 0.9))
    teeth.plot(time, 1e3 * done.teeth, label="torque of the teeth", **_TEETH)
    teeth.set(ylabel="on the load, mN m", ylim=(-5.0, 5.0))
    teeth.set(xlabel="time after the step, s", xlim=(least, most))
    teeth.legend(loc="upper right", fontsize="small")
    return figure


def hold(done: Trace) -> Figure:
    """Draw a load torque that comes on while the load is parked: the motor in the gap, and the torques."""
    figure, panels = _panels((3.2, 1.9), f"Hold: a load torque of {_TORQUE:g} N m comes on while the load is parked")
    gap, torque = panels
    time, least, most = done.time - _SETTLED, -0.08, 0.6
    _shade(panels, _spans(done, _SETTLED + least, _SETTLED + most, _SETTLED, flanks=False))
    _near(gap, time, done)
    gap.set(ylim=(-1.3, 0.8))
    torque.plot(time, done.teeth, label="torque of the teeth", **_TEETH)
    words = f"where the teeth meet: up to {np.max(done.teeth[time > 0.0]):.1f} N m"
    torque.text(0.013, 0.7, words, fontsize="small", va="center")
    torque.plot(time, done.load_torque, color="C3", linewidth=1.4, label="load torque")
    estimated = [memory.load_torque.estimated for memory in done.memories]
    torque.plot(time, estimated, label="load torque as estimated", **_PLANNED)
    compensation = [memory.motor.compensation for memory in done.memories]
    torque.plot(time, compensation, label="unforeseen torque: compensation", **_COMPENSATED)
    torque.set(ylabel="N m", ylim=(-0.3, 0.9))
    torque.set(xlabel="time after the load torque, s", xlim=(least, most))
    torque.legend(loc="upper right", fontsize="small")
    return figure


FIGURES: dict[str, Callable[[Trace], Figure]] = {"flight": flight, "landing": landing, "hold": hold}


def draw(out: Path) -> list[str]:
    """Write the pictures into a folder, all or none, and return their names."""
    done = trace()
    with staging(out / "pictures") as folder, plt.rc_context({"axes.grid": True, "grid.alpha": 0.3}):
        for name, make in FIGURES.items():
            figure = make(done)
            figure.savefig(folder / f"planned_{name}.png", dpi=110)
            plt.close(figure)
        files = sorted(folder.iterdir())
        for file in files:
            file.replace(out / file.name)
    return [file.name for file in files]
