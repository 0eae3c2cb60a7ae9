"""How a simulated loop responded: arrays, figures in a line or a table, a picture, a data frame."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.markup import pairs
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import CURRENT, OMEGA_L, OMEGA_M, THETA_L, THETA_M
from backlash_ros.simulation.colours import LIGHT

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NEAR = 1.5
"""Largest distance from the setpoint that is drawn, b."""
_STYLE: Any = {
    "figure.facecolor": LIGHT["paper"],
    "axes.facecolor": LIGHT["paper"],
    "axes.edgecolor": LIGHT["faint"],
    "axes.labelcolor": LIGHT["ink"],
    "text.color": LIGHT["ink"],
    "xtick.color": LIGHT["ink"],
    "ytick.color": LIGHT["ink"],
    "axes.titlelocation": "left",
    "axes.titlesize": "medium",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": LIGHT["band"],
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "legend.fontsize": "small",
    "legend.frameon": False,
}


@dataclass(frozen=True, eq=False)
class Run:
    """A closed-loop run of a ``drive`` with a ``law``: ``substeps`` plant samples per controller sample, from t = 0 on.

    ``state`` (N * substeps + 1, 5) at ``time``; per controller sample, each of shape (N,): ``setpoint``, the wanted
    load angle, rad; ``command`` (V or A); ``region``; ``load_torque_estimate``, N m; ``peak_force``, the largest force
    on the teeth within the period, N; ``measured_load_angle``, what the load's encoder showed the controller, rad, nan
    without one. ``fault`` is the text of the fault latched at sample ``fault_sample``, from which on the command is 0;
    "" and -1 for none.
    """

    drive: Drive
    law: str
    time: Array
    state: Array
    setpoint: Array
    command: Array
    region: Array
    load_torque_estimate: Array
    peak_force: Array
    measured_load_angle: Array
    fault: str = ""
    fault_sample: int = -1

    @property
    def load_angle(self) -> Array:
        """theta_l at ``time``, rad."""
        return self.state[:, THETA_L]

    @property
    def motor_angle(self) -> Array:
        """theta_m at ``time``, before the gear, rad."""
        return self.state[:, THETA_M]

    @property
    def gap(self) -> Array:
        """R1 theta_m - R2 theta_l at ``time``, m: between -d/2 and d/2 the teeth are free."""
        gear = self.drive.gear
        return gear.motor_radius * self.motor_angle - gear.load_radius * self.load_angle

    @property
    def error(self) -> Array:
        """Load angle less setpoint at ``time``, rad."""
        held = np.repeat(self.setpoint, self._substeps)
        return self.load_angle - np.append(held, held[-1:])

    @property
    def _substeps(self) -> int:
        return (self.time.size - 1) // max(self.command.size, 1)

    def table(self) -> dict[str, tuple[str, Array]]:
        """Return the run as a table, one row per controller sample: by column, the unit and the values, shape (N,).

        True values but for ``load_torque_estimate`` and ``measured_load``: ``reference`` is the setpoint, ``motor``
        before the gear, ``gap`` along the pitch line, ``region`` 2 where the over-damped gains act, else 1. Those that
        ``backlash identify`` reads have the names that it expects.
        """
        rows = slice(0, -1, self._substeps)
        state = self.state[rows]
        return {
            "time": ("s", self.time[rows]),
            "reference": ("rad", self.setpoint),
            "load": ("rad", state[:, THETA_L]),
            "load_velocity": ("rad/s", state[:, OMEGA_L]),
            "motor": ("rad", state[:, THETA_M]),
            "motor_velocity": ("rad/s", state[:, OMEGA_M]),
            "current": ("A", state[:, CURRENT]),
            "gap": ("m", self.gap[rows]),
            "command": (self.drive.command_unit, self.command),
            "region": ("", self.region),
            "load_torque_estimate": ("N m", self.load_torque_estimate),
            "peak_force": ("N", self.peak_force),
            "measured_load": ("rad", self.measured_load_angle),
        }

    def to_frame(self) -> "pandas.DataFrame":
        """Return the `table` as a pandas data frame over the time in s; ``frame.attrs["units"]`` has the units.

        Raises
        ------
        ImportError
            If pandas is not installed: it is an extra, ``backlash_ros[tables]``.
        """
        try:
            import pandas  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise ImportError("Run.to_frame needs pandas: pip install 'backlash_ros[tables]'") from error
        table = self.table()
        frame = pandas.DataFrame({name: values for name, (_, values) in table.items()}).set_index("time")
        frame.attrs["units"] = {name: unit for name, (unit, _) in table.items()}
        return frame

    def _figures(self) -> Mapping[str, str]:
        """Return what happened, by name, with units; only of a run that has samples."""
        b, period = self.drive.gear.backlash_angle, float(self.time[self._substeps])
        last = self.time >= self.time[-1] - 1.0
        return {
            "law": self.law,
            "time": f"{self.time[-1]:g} s, {self.command.size} samples at {1.0 / period:g} Hz",
            "load at the end": f"{self.load_angle[-1]:.3f} rad, {self.error[-1] / b:+.2f} b from its setpoint",
            "swing of the load in the last second": f"{float(np.ptp(self.load_angle[last])) / b:.3f} b",
            "largest command": f"{float(np.max(np.abs(self.command))):.3g} {self.drive.command_unit}",
            "largest force on the teeth": f"{float(np.max(self.peak_force)):.3g} N",
            "fault": self.fault or "none",
        }

    def __repr__(self) -> str:
        """Return law, length, end and fault in a line."""
        if not self.command.size:
            return f"Run({self.law}: no samples)"
        figures = self._figures()
        return f"Run({self.law}: {figures['time']}; load at {figures['load at the end']}; fault: {figures['fault']})"

    def _repr_html_(self) -> str:
        """Return the figures as a table, for notebooks."""
        if not self.command.size:
            return pairs([("law", self.law), ("time", "no samples")])
        return pairs(self._figures().items())

    def plot(self) -> "Figure":
        """Draw the run: load, motor and setpoint; the load near its setpoint; the gap; the command.

        Returns
        -------
        matplotlib's figure, which can be shown, saved and changed; its four axes are in this order. Distances in b are
        in units of the drive's backlash.
        """
        import matplotlib  # noqa: PLC0415 - takes a second
        import matplotlib.pyplot as plt  # noqa: PLC0415

        with plt.rc_context(_STYLE):
            figure, panels = plt.subplots(
                4, 1, figsize=(8, 8.5), sharex=True, constrained_layout=True, height_ratios=[1.5, 1.2, 1.0, 1.0]
            )
            self._draw(*panels)
            figure.align_ylabels(panels)
        if "inline" in matplotlib.get_backend():  # a notebook shows the returned figure; it would show it twice
            plt.close(figure)
        return figure

    def _draw(self, whole: "Axes", near: "Axes", gap: "Axes", command: "Axes") -> None:
        gear, samples = self.drive.gear, self.time[: -1 : self._substeps]
        load: Any = {"color": LIGHT["load"], "linewidth": 1.4}
        motor: Any = {"color": LIGHT["motor"], "linewidth": 1.0}
        wanted: Any = {"color": LIGHT["ink"], "linewidth": 0.9, "linestyle": ":"}
        whole.plot(self.time, gear.ratio * self.motor_angle, label="motor, through the gear", **motor)
        whole.plot(self.time, self.load_angle, label="load", **load)
        whole.step(samples, self.setpoint, where="post", label="setpoint", **wanted)
        whole.set_ylabel("angle at the output, rad")
        whole.set_title(f"law {self.law}")
        whole.legend(loc="lower right", ncol=3)
        near.axhspan(-0.5, 0.5, color=LIGHT["band"], linewidth=0, zorder=0)
        near.axhline(0.0, **wanted)
        near.plot(self.time, self.error / gear.backlash_angle, **load)
        near.set(ylim=(-_NEAR, _NEAR), ylabel="load from setpoint, b")
        gap.plot(self.time, self.gap / gear.backlash, **motor)
        for flank in (-0.5, 0.5):
            gap.axhline(flank, **wanted)
        gap.set_ylabel("motor in the gap, b")
        command.step(samples, self.command, where="post", color=LIGHT["ink"], linewidth=1.0)
        command.set(ylabel=f"command, {self.drive.command_unit}", xlabel="time, s", xlim=(0.0, self.time[-1]))
        if self.fault:
            for axes in (whole, near, gap, command):
                axes.axvline(float(samples[self.fault_sample]), color=LIGHT["bad"], linewidth=1.0)
            whole.set_title(f"law {self.law}; fault: {self.fault}", color=LIGHT["bad"])
