"""The pictures of a certificate as SVG in the colours of the page: light, dark, on paper."""

import math
import re
from collections.abc import Callable
from io import StringIO
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.gap_map import GapMap
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.locked_output.ramps import Ramps
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.identification.recordings.held_out import Score, free_simulations
from backlash_ros.identification.teeth import loop_of, static_torque
from backlash_ros.recordings.rounding import GEAR_UNITS, in_gear_units
from backlash_ros.recordings.subject import Subject

INK, FAINT, MOTOR, LOAD, MODEL, BAND = (f"#0a0b{k:02x}" for k in range(1, 7))
"""Placeholders for the page's colours, which no picture has by chance."""
_COLOURS = {INK: "ink", FAINT: "faint", MOTOR: "motor", LOAD: "load", MODEL: "model", BAND: "band"}
"""The page's variables that replace them."""
_MOST = 1500
"""Largest number of points of a curve."""
_WIDTH = 5.0
_STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "backlash_ros",
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "grid.color": BAND,
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
}
_DOT: dict[str, Any] = {"linestyle": "none", "marker": ".", "markeredgewidth": 0}


def _svg(figure: Figure, name: str, title: str) -> str:
    """Return a figure as an element of a page, with unique ids and the page's colours."""
    out = StringIO()
    figure.savefig(out, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    plt.close(figure)
    text = out.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style[^>]*>.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    box = re.search(r'viewBox="[^"]*"', text)
    assert box is not None
    label = title.replace('"', "'")
    text = re.sub(r"<svg[^>]*>", f'<svg {box[0]} role="img" aria-label="{label}">', text, count=1)
    text = text.replace("xlink:href=", "href=")
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'href="#', f'href="#{name}-', text)
    text = re.sub(r"url\(#", f"url(#{name}-", text)
    text = re.sub(r"font: ([\d.]+)px [^;\"]*", r"font: \1px sans-serif", text)
    for colour, variable in _COLOURS.items():
        text = text.replace(colour, f"var(--{variable})")
    return re.sub(r"\n\s*", "\n", text)


def _thin(*columns: Array) -> list[Array]:
    """Return columns thinned evenly to few enough rows."""
    step = max(1, math.ceil(columns[0].size / _MOST))
    return [column[::step] for column in columns]


def _legend(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend above the axes, clear of the curves."""
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns, borderaxespad=0.2, handlelength=1.4)
    figure.align_ylabels()


def _residual(measured: Array, modelled: Array, count: float) -> tuple[Array, str]:
    """Return the difference of measurement and model, and its unit: counts if the encoder has them."""
    miss = measured - modelled
    return (miss / count, "counts") if count > 0.0 else (1e3 * miss, "mrad")


def motion_picture(
    told: Subject, recording: Recording, before: Fit | None, score: Score | None, counts: tuple[float, float]
) -> str:
    """Return a picture of the recording, the free simulations of the held-out part, and their errors.

    Parameters
    ----------
    recording : the part that was fitted
    before, score : the fit without the last quarter and its score there; None if nothing was fitted
    counts : of both encoders at the output, rad; 0 if unknown
    """
    time = recording.time - recording.time[0]
    if before is None or score is None:
        figure, axes = plt.subplots(figsize=(_WIDTH, 2.6), constrained_layout=True)
        _angles(axes, time, recording)
        axes.set_xlabel("time, s")
        _legend(figure, axes, 2)
        return _svg(figure, "motion", "Both angles over time as measured.")
    figure, (whole, near, *rest) = plt.subplots(
        4, 1, figsize=(_WIDTH, 6.6), constrained_layout=True, height_ratios=[1.2, 1.8, 1, 1]
    )
    _angles(whole, time, recording)
    whole.axvspan(score.start, score.start + score.length, color=BAND, linewidth=0, zorder=0)
    whole.set_xlabel("time, s (shaded: held out)")
    _legend(figure, whole, 2)
    for angle, colour, name in ((recording.motor, MOTOR, "motor"), (recording.load, LOAD, "load")):
        held = time >= score.start
        near.plot(*_thin(time[held], angle[held] - angle[0]), color=colour, label=name, markersize=6, **_DOT)
    near.plot([], [], color=MODEL, linewidth=1.0, label="modelled")
    runs = free_simulations(told.told, before, recording)
    for run in runs:
        at = run.time - recording.time[0]
        rows = np.searchsorted(recording.time, run.time)
        for angle, first in ((run.motor, recording.motor[0]), (run.load, recording.load[0])):
            near.plot(*_thin(at, angle - first), color=MODEL, linewidth=0.8)
        for axes, measured, modelled, colour, count in (
            (rest[0], recording.motor[rows], run.motor, MOTOR, counts[0]),
            (rest[1], recording.load[rows], run.load, LOAD, counts[1]),
        ):
            miss, unit = _residual(measured, modelled, count)
            axes.plot(*_thin(at, miss), color=colour, linewidth=1.0)
            axes.set_ylabel(f"{'motor' if axes is rest[0] else 'load'},\n{unit}")
    for axes in (near, *rest):
        axes.set_xlim(score.start, score.start + score.length)
    near.set_ylabel("angle, rad")
    near.tick_params(labelbottom=False)
    rest[0].tick_params(labelbottom=False)
    rest[0].set_title("measured less modelled")
    rest[1].set_xlabel("time, s")
    _legend(figure, near, 3)
    return _svg(figure, "motion", "Both angles over time, measured and modelled, and their difference.")


def _angles(axes: Axes, time: Array, recording: Recording) -> None:
    for angle, colour, name in ((recording.motor, MOTOR, "motor, through the gear"), (recording.load, LOAD, "load")):
        axes.plot(*_thin(time, angle - angle[0]), color=colour, linewidth=1.2, label=name)
    axes.set(ylabel="angle, rad", xlim=(time[0], time[-1]))


def loop_picture(told: Subject, recording: Recording, found: Fit, width: Finding) -> str:
    """Return the teeth's torque over their twist, with the fitted law and its ``width`` if it was determined."""
    loop = loop_of(told.told, found, recording)
    factor, _ = GEAR_UNITS["rad"]
    figure, axes = plt.subplots(figsize=(_WIDTH, 4.4), constrained_layout=True)
    if width.told:
        axes.axvspan(-500.0 * width.value, 500.0 * width.value, color=BAND, linewidth=0, zorder=0)
        place: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "top"}
        axes.text(0.0, 0.96, f"gap\n{in_gear_units(width)}", **place)
    axes.plot(*_thin(1e3 * loop.twist, loop.torque), color=MOTOR, markersize=4, label="by the samples", **_DOT)
    twist = np.linspace(float(np.min(loop.twist)), float(np.max(loop.twist)), 201)
    axes.plot(1e3 * twist, static_torque(found, twist), color=MODEL, linewidth=1.4, label="law, at rest")
    axes.set(xlabel="motor's angle through the gear less the load's, mrad", ylabel="torque of the teeth, N m")
    top = axes.secondary_xaxis("top", functions=(_times(1e-3 * factor), _times(1e3 / factor)))
    top.set_xlabel("arcmin")
    axes.legend(loc="lower right", frameon=False)
    return _svg(figure, "loop", "The torque of the teeth over the angle between the shafts.")


def around_picture(found: GapMap) -> str:
    """Return the gap at each place around the output's turn with its standard uncertainty, and the mean."""
    factor, unit = GEAR_UNITS["rad"]
    places, gaps = np.array(found.places), 1e3 * np.array(found.gaps)
    figure, axes = plt.subplots(figsize=(_WIDTH, 3.6), constrained_layout=True)
    axes.axhline(1e3 * found.mean, color=FAINT, linewidth=1.0, linestyle="--", label="mean of the places")
    bars: dict[str, Any] = {"ecolor": MODEL, "elinewidth": 1.2, "capsize": 3.0, "zorder": 3}
    axes.errorbar(
        places, gaps, 1e3 * np.array(found.uncertainties), fmt="o-", color=MOTOR, markersize=5, linewidth=0.6, **bars
    )
    low, high = float(np.min(gaps)), float(np.max(gaps))
    room = max(0.25 * (high - low), 4e3 * max(found.uncertainties))
    axes.set(
        xlabel="what the load's encoder reads at the place, rad", ylabel="gap, mrad", ylim=(low - room, high + room)
    )
    for k, name, side in ((found.smallest, "smallest", -1), (found.largest, "largest", 1)):
        said = f"{name}, {factor * found.gaps[k]:.4g} {unit}"
        near, far = axes.get_xlim()
        share = (places[k] - near) / (far - near)
        axes.annotate(
            said,
            (places[k], gaps[k]),
            (0, side * 10),
            textcoords="offset points",
            ha="left" if share < 0.25 else "right" if share > 0.75 else "center",
            va="center",
        )
    right = axes.secondary_yaxis("right", functions=(_times(1e-3 * factor), _times(1e3 / factor)))
    right.set_ylabel(unit)
    _legend(figure, axes, 1)
    return _svg(figure, "around", "The gap over the angle of the load, with its standard uncertainty.")


def hysteresis_picture(found: LostMotion) -> str:
    """Return the angle between the shafts over a slow torque, with the branches as fitted and the lost motion."""
    factor, unit = GEAR_UNITS["rad"]
    figure, axes = plt.subplots(figsize=(_WIDTH, 4.4), constrained_layout=True)
    axes.axhspan(-500.0 * found.gap, 500.0 * found.gap, color=BAND, linewidth=0, zorder=0)
    axes.text(0.02, 0.0, f"gap\n{factor * found.gap:.4g} {unit}", transform=axes.get_yaxis_transform(), va="center")
    axes.plot(found.torques, 1e3 * found.angles, color=MOTOR, markersize=4, label="measured", **_DOT)
    axes.plot(found.torques, 1e3 * found.modelled, color=MODEL, linewidth=1.2, label="branches as fitted")
    lost, at = 500.0 * found.lost_motion, found.at
    axes.plot([-at, at], [-lost, lost], color=LOAD, markersize=8, marker="_", linestyle="none", markeredgewidth=2)
    arrow: dict[str, Any] = {"arrowstyle": "<->", "color": LOAD, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (0.0, lost), (0.0, -lost), arrowprops=arrow)
    said = f"lost motion\n{factor * found.lost_motion:.4g} {unit}"
    axes.text(0.98, 0.0, said, transform=axes.get_yaxis_transform(), ha="right", va="center", color=LOAD)
    axes.set(
        xlabel="torque of the motor at the output, N m", ylabel="motor's angle through the gear less the load's, mrad"
    )
    right = axes.secondary_yaxis("right", functions=(_times(1e-3 * factor), _times(1e3 / factor)))
    right.set_ylabel(unit)
    _legend(figure, axes, 2)
    return _svg(figure, "hysteresis", "The angle between the shafts over a torque that goes slowly up and down.")


def ramps_picture(found: Ramps, name: str) -> str:
    """Return the curve of angle over torque, ramp by ramp, with the lost motion at zero torque."""
    figure, axes = plt.subplots(figsize=(_WIDTH, 4.4), constrained_layout=True)
    degree = math.pi / 180.0
    middle = 0.5 * (float(np.max(found.angles)) + float(np.min(found.angles)))
    angles = (found.angles - middle) / degree
    every = max(1, angles.size // (4 * _MOST))
    ends = [*found.begins[1:], angles.size]
    for k, (begin, end) in enumerate(zip(found.begins, ends, strict=True)):
        first = k == 0 and math.isfinite(found.at_zero.first)
        rows = slice(begin, end + every, every)
        label = "first ramp" if first else "other ramps" if k == 1 and math.isfinite(found.at_zero.first) else None
        axes.plot(found.torques[rows], angles[rows], color=FAINT if first else MOTOR, linewidth=0.9, label=label)
    low, high = ((place - middle) / degree for place in found.flanks)
    arrow: dict[str, Any] = {"arrowstyle": "<->", "color": LOAD, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (0.0, high), (0.0, low), arrowprops=arrow)
    axes.text(0.0, 0.5 * (low + high), f"  {found.at_zero.mean / degree:.3g} deg", color=LOAD, va="center")
    axes.set(xlabel="torque at the output, N m", ylabel="angle at the output from its middle, deg")
    if math.isfinite(found.at_zero.first):
        _legend(figure, axes, 2)
    return _svg(figure, name, "The angle over the torque, ramp by ramp.")


def _times(factor: float) -> Any:
    return lambda values: np.asarray(values) * factor


def draw(make: Callable[..., str], *args: Any, **options: Any) -> Markup:
    """Return a picture for a page, drawn in the certificate's style."""
    with plt.rc_context(_STYLE):
        return Markup(make(*args, **options))  # noqa: S704 - drawn here
