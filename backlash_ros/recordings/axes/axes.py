"""The axes in a bag: the samples of each in SI units, and the messages of its controller, on one clock."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from backlash_ros.drive_file.drive_file import axis_of, read_axis
from backlash_ros.foundation.reading.parameter_files import in_sections
from backlash_ros.foundation.record import Array
from backlash_ros.recordings.axes.axis import Axis
from backlash_ros.recordings.axes.contents import Contents, Numbers, Sample
from backlash_ros.recordings.axes.options import EFFORT_UNITS, VELOCITY_UNITS, Options
from backlash_ros.recordings.bag import Series
from backlash_ros.recordings.encoder import Encoder
from backlash_ros.recordings.samples import LARGEST

CLOCKS_DIFFER = 10.0
"""Age of samples above which it shows the clocks and not the samples, s."""
_READ = "numbers of std_msgs such as Float64"
_STRAY, _FEW = 0.01, 3
"""Share of stamps that may stand still or go back, and least number of different ones; else the recorder's times are
used."""


def joint_columns(samples: Sequence[Sample], joint: str) -> Array:
    """Return position, velocity and effort of a joint, shape (N, 3), nan if missing or no number that can be."""
    rows = np.full((len(samples), 3), math.nan)
    places: dict[tuple[str, ...], int] = {}
    for k, sample in enumerate(samples):
        if sample.names not in places:
            places[sample.names] = sample.names.index(joint) if joint in sample.names else -1
        if (at := places[sample.names]) >= 0:
            for column, values in enumerate(sample[3:]):
                if at < len(values):
                    rows[k, column] = values[at]
    rows[~(np.abs(rows) <= LARGEST)] = math.nan
    return rows


def _rising(times: Array) -> Any:
    """Return which times are later than all previous ones."""
    return np.concatenate([[True], times[1:] > np.maximum.accumulate(times)[:-1]])


def _sent_again(before: Sample, sample: Sample) -> bool:
    """Return whether a sample is the one before it, sent again, as a simulator in lockstep does until an answer."""
    same = before.stamp == sample.stamp and before.names == sample.names
    return same and all(map(np.array_equal, before[3:], sample[3:]))


def _clock(samples: Sequence[Sample], options: Options) -> tuple[Array, str]:
    """Return the times of samples, s, and why these are not the stamps; empty if they are, or on request."""
    stamps, received = (np.array(times) for times in zip(*(sample[:2] for sample in samples), strict=True))
    if options.topics.stamps == "log":
        return received, ""
    still = np.flatnonzero(~_rising(stamps)).tolist()
    stray = len(still) - sum(_sent_again(samples[k - 1], samples[k]) for k in still)
    if stray > _STRAY * stamps.size or stamps.size - len(still) < min(_FEW, stamps.size):
        return (
            received,
            f"{len(still)} of {stamps.size} stamps stand still or go back, so the recorder's times are used",
        )
    return stamps, ""


def _namespace(topic: str, parts: int) -> str:
    """Return the namespace of a topic, without so many names at its end."""
    return "/".join(topic.split("/")[:-parts]) or "/"


def _numbers(found: Sequence[Numbers], index: int) -> Series:
    rows = [(message.received, float(message.values[index])) for message in found if index < len(message.values)]
    times, values = np.array(rows).reshape(-1, 2).T
    return Series(times, np.where(np.abs(values) <= LARGEST, values, math.nan))


def _only(names: Sequence[str], what: str, option: str, notes: list[str]) -> str:
    """Return the only name; of several, none, with a note on the option that chooses."""
    if len(names) > 1:
        notes.append(f"{what}: {option} must say which of {', '.join(sorted(names))}")
    return names[0] if len(names) == 1 else ""


def _zeros(versions: Sequence[tuple[float, int, Mapping[str, Any]]], received: Array) -> Array:
    """Return the zero of the axis at times of receipt, as readings of the load's angle, rad."""
    zeros = np.array([0.0, *(float(values.get("zero", 0.0)) for _, _, values in versions)])
    return zeros[np.searchsorted([at for at, _, _ in versions], received, side="right")]


class _Builder:
    """Puts one axis together."""

    def __init__(self, contents: Contents, options: Options, namespace: str, alone: bool) -> None:
        self._contents, self._options, self._namespace, self._alone = contents, options, namespace, alone
        self.notes: list[str] = []
        self.missing: list[str] = []

    def _of_axis(self, topics: Iterable[str], parts: int) -> list[str]:
        """Return the topics of this axis; all if it is the only one."""
        topics = list(topics)
        own = [topic for topic in topics if _namespace(topic, parts) == self._namespace]
        return own or (topics if self._alone else [])

    def build(self, joint_topic: str) -> Axis:
        """Return the axis with samples on ``joint_topic``, which is empty without samples."""
        contents = self._contents
        states = self._of_axis(contents.states, 2)
        if len(states) > 1:
            self.notes.append(f"of {len(states)} controllers, {', '.join(states)}, the first is shown")
        state = {} if not states else _series_by_name(contents.states[states[0]])
        versions = self._versions()
        axis = self._with_drive(Axis(self._namespace, state=state, versions=versions))
        axis = self._with_samples(axis, joint_topic)
        zero, mapped = self._clock_of(axis)
        axis = replace(
            axis,
            clock=mapped,
            time=axis.time - zero,
            state={name: Series(s.time - zero, s.values) for name, s in state.items()},
            versions=[(at - zero, version, values) for at, version, values in versions],
        )
        on_clock = self._on_clock(axis, zero)
        axis = self._with_reference(axis, on_clock)
        axis = self._with_command(axis, on_clock)
        for name, topic, parts in (("load_torque", "load_torque", 1), ("estimates", "backlash_estimate", 2)):
            if len(found := self._named(topic, parts)) == 1:
                axis = replace(axis, **{name: on_clock(_numbers(contents.numbers[found[0]], 0))})
        return replace(axis, notes=tuple(self.notes), missing=tuple(self.missing))

    def _named(self, name: str, parts: int = 1) -> list[str]:
        """Return the numeric topics of this axis that end with a name."""
        named = [topic for topic in self._contents.numbers if topic.split("/")[-1] == name]
        return self._of_axis(named, parts)

    def _versions(self) -> list[tuple[float, int, Mapping[str, Any]]]:
        own = [topic for topic in self._of_axis(self._contents.in_use, 2) if "/plant_simulator/" not in topic]
        if not own:
            self.missing.append("parameters in use (~/parameters_in_use): gain swaps, laws and the drive as told")
            return []
        return [(stamp, version, values) for stamp, version, values in self._contents.in_use[own[0]]]

    def _in_lockstep(self) -> bool:
        """Whether the drive was simulated in lockstep."""
        own = [topic for topic in self._of_axis(self._contents.in_use, 2) if "/plant_simulator/" in topic]
        return any(values.get("lockstep") for topic in own for _, _, values in self._contents.in_use[topic])

    def _with_drive(self, axis: Axis) -> Axis:
        if self._options.drive is not None:
            return replace(axis, drive=read_axis(self._options.drive).drive, drive_source=str(self._options.drive))
        if axis.versions:
            try:
                drive = axis_of(in_sections(axis.versions[-1][2])).drive
            except ValueError as error:
                self.notes.append(f"the parameters in use describe no drive: {error}")
            else:
                return replace(axis, drive=drive, drive_source="the parameters in use in the bag")
        self.missing.append(
            "motor and gear: give them with --drive for the gap, impacts and the motor through the gear"
        )
        return axis

    def _joints(self, axis: Axis, samples: Sequence[Sample]) -> tuple[str, str]:
        """Return the joints of motor and load: as requested, as in use, or with the interface's names."""
        told = axis.versions[-1][2] if axis.versions else {}
        topics, names = self._options.topics, {name for sample in samples for name in sample.names}
        result = []
        for shaft, given in (("motor", topics.motor_joint), ("load", topics.load_joint)):
            joint = given or str(told.get(f"{shaft}_joint", shaft))
            if joint not in names:
                has = ", ".join(sorted(names)) or "no names"
                self.missing.append(f"the {shaft}'s angle: no joint '{joint}' there (has {has}); see --{shaft}-joint")
            result.append(joint if joint in names else "")
        return result[0], result[1]

    def _with_samples(self, axis: Axis, topic: str) -> Axis:
        samples = self._contents.samples.get(topic, [])
        if not samples:
            self.missing.append("joint states: figures of steps, and the timing of samples")
            return axis
        options, reading = self._options, self._options.reading
        joints = self._joints(axis, samples)
        times, why = _clock(samples, options)
        self.notes += [why] if why else []
        kept = np.flatnonzero(_rising(times))
        samples = [samples[k] for k in kept]
        times = times[kept]
        angles, speeds, efforts = [], [], []
        speed_unit, effort_unit = VELOCITY_UNITS[options.velocity_unit], EFFORT_UNITS[options.effort_unit]
        if options.effort_unit == "A":
            if axis.drive is None:
                raise ValueError("argument --effort-unit: A needs the torque constant of a --drive")
            effort_unit = axis.drive.motor.torque_constant
        for joint, encoder in zip(joints, (reading.motor, reading.load), strict=True):
            columns = joint_columns(samples, joint)
            angle = columns[:, 0]
            if np.any(np.isfinite(angle)):
                angle[~np.isfinite(angle)] = math.nan
                angle = self._radians(times, angle, joint, encoder)
            elif joint:
                self.missing.append(f"the position of joint '{joint}'")
            angles.append(angle)
            speeds.append(columns[:, 1] * speed_unit)
            efforts.append(columns[:, 2] * effort_unit)
        if joints[0] and not np.any(np.isfinite(efforts[0])):
            self.missing.append(f"the effort of joint '{joints[0]}': peak torque")
        motor = angles[0]
        if reading.motor_at == "output":
            if axis.drive is None:
                raise ValueError("argument --motor-at: output needs the gear of a --drive")
            motor = motor / axis.ratio
        received = np.array([sample.received for sample in samples])
        zero = _zeros(axis.versions, received)
        return replace(
            axis,
            joint_topic=topic,
            motor_joint=joints[0],
            load_joint=joints[1],
            time=times,
            received=received,
            stamps=np.array([sample.stamp for sample in samples]),
            motor=motor - zero / axis.ratio if np.any(zero) else motor,
            load=angles[1] - zero,
            load_speed=speeds[1],
            torque=efforts[0],
            repeated=len(self._contents.samples[topic]) - len(samples),
        )

    def _radians(self, times: Array, angle: Array, joint: str, encoder: Encoder) -> Array:
        """Return the angles of a joint in rad; unchanged if they wrap around at an unknown value."""
        try:
            result, note = encoder.radians(
                times, angle, f"joint '{joint}'", lambda k: f"at {times[k] - times[0]:.3f} s"
            )
        except ValueError as error:
            result, note = angle * (2.0 * math.pi / encoder.turn), f"{error}; taken as it is"
        self.notes += [note] if note else []
        return result

    def _clock_of(self, axis: Axis) -> tuple[float, str]:
        """Return the time that is 0 in the page, s, and the name of the axis's clock if it is not the recorder's."""
        start = self._contents.start
        first = axis.time[0] if axis.time.size else math.nan
        if math.isnan(first):
            stamps = [series.time[0] for series in axis.state.values() if series.time.size]
            first = min(stamps) if stamps else start
        age = float(np.median(axis.received - axis.time)) if axis.time.size else start - first
        if abs(age) <= CLOCKS_DIFFER:
            return start, ""
        return float(first), "a clock of its own, counted from its first sample"

    def _on_clock(self, axis: Axis, zero: float) -> Any:
        """Return a function from the recorder's times to the axis's clock."""

        def shifted(series: Series) -> Series:
            if not axis.clock:
                return Series(series.time - zero, series.values)
            return Series(np.interp(series.time, axis.received, axis.time), series.values)

        return shifted if axis.time.size or not axis.clock else lambda series: series

    def _hint(self, option: str) -> str:
        """Return the topics that an option can name."""
        has = ", ".join(sorted(self._of_axis(self._contents.numbers, 1)))
        return f"; numbers are on {has}: {option} names the one" if has else ""

    def _not_read(self, name: str) -> str:
        """Return which topics of a name have another type than those that are read."""
        topics = self._contents.topics
        others = [f"'{topic}' ({topics[topic][0]})" for topic in self._of_axis(topics, 1) if topic.endswith(f"/{name}")]
        return f"; not read, since only {_READ} are: {', '.join(others)}" if others else ""

    def _with_reference(self, axis: Axis, on_clock: Any) -> Axis:
        options, numbers = self._options, self._contents.numbers
        topic = options.reference_topic
        if topic and (topic := topic if topic.startswith("/") else f"/{topic}") not in numbers:
            kind = self._contents.topics.get(topic, ("",))[0]
            but = f", but {kind}: only {_READ} are read" if kind else ""
            raise ValueError(f"argument --reference-topic: there are no numbers on '{topic}'{but}")
        if not topic and "reference" in axis.state:
            return replace(axis, reference=axis.state["reference"], reference_source="~/state")
        if not topic:
            topic = _only(self._named("reference"), "reference", "--reference-topic", self.notes)
        if not topic:
            self.missing.append(
                f"a reference, so steps are unknown{self._hint('--reference-topic')}{self._not_read('reference')}"
            )
            return axis
        series = _numbers(numbers[topic], 0)
        turn = options.reference_encoder.turn
        series = Series(series.time, series.values * (2.0 * math.pi / turn))
        return replace(axis, reference=on_clock(series), reference_source=topic)

    def _with_command(self, axis: Axis, on_clock: Any) -> Axis:
        topics, numbers = self._options.topics, self._contents.numbers
        topic = topics.command
        if topic and (topic := topic if topic.startswith("/") else f"/{topic}") not in numbers:
            raise ValueError(f"argument --command-topic: there are no numbers on '{topic}'")
        if not topic:
            topic = _only(self._named("command"), "commands", "--command-topic", self.notes)
        if not topic:
            self.missing.append(f"commands, and whether samples were answered in time{self._hint('--command-topic')}")
            return axis
        series = _numbers(numbers[topic], topics.index)
        told = self._options.reading.command_unit
        unit = told or (axis.drive.command_unit if axis.drive is not None else "")
        if told == "duty":
            series, unit = Series(series.time, series.values * self._options.reading.supply), "V"
        answered = np.array([message.answers for message in numbers[topic] if topics.index < len(message.values)])
        command = on_clock(series)
        if axis.clock and self._in_lockstep():  # time stood still until the answer was there
            command = Series(np.where(np.isfinite(answered), answered - axis.stamps[0], command.time), command.values)
        return replace(
            axis,
            command=command,
            command_unit=unit,
            command_topic=topic,
            answered=answered,
            commands_received=series.time,
        )


def _series_by_name(states: Sequence[tuple[float, Mapping[str, float]]]) -> dict[str, Series]:
    times = np.array([stamp for stamp, _ in states])
    names = dict.fromkeys(name for _, values in states for name in values)
    return {name: Series(times, np.array([values.get(name, math.nan) for _, values in states])) for name in names}


def axes_of(contents: Contents, options: Options) -> list[Axis]:
    """Return the axes in a bag in the order of their names: one for each topic of joint states.

    Without joint states: one for each controller that published its state.

    Raises
    ------
    OSError, ValueError
        Names the option that does not fit the bag, or the angles that cannot be read.
    """
    topics = {topic: _namespace(topic, 1) for topic in contents.samples}
    if given := options.topics.joint_states:
        given = given if given.startswith("/") else f"/{given}"
        if given not in topics:
            raise ValueError(
                f"argument --joint-topic: there are no joint states on '{given}'; there are on {sorted(topics)}"
            )
        topics = {given: topics[given]}
    namespaces = [(space, topic) for topic, space in topics.items()]
    if not namespaces:
        namespaces = [(space, "") for space in dict.fromkeys(_namespace(topic, 2) for topic in contents.states)]
    namespaces = sorted(namespaces) or [("/", "")]
    alone = len(namespaces) == 1
    return [_Builder(contents, options, space, alone).build(topic) for space, topic in namespaces]
