"""What the page says of an axis: its state, its fault, the law that acts, and what an experiment found."""

import json
import math
import time
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import pytest

pytest.importorskip("rclpy", reason="needs rclpy")

from backlash_ros.control.experiment import BacklashEstimate, DriveEstimate, Method
from backlash_ros.dashboard import state
from backlash_ros.dashboard.axis import Answer, Axis, Diagnosis, Told
from backlash_ros.dashboard.cards import card
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.parameters import values_of
from backlash_ros.gates.faults import FAULTS, Fault
from backlash_ros.identification.recordings.findings import Finding
from backlash_ros.nodes.learning import quantities_of


@dataclass
class Seen:
    """What the page knows of an axis that holds its position."""

    title: str = "/"
    present: bool = True
    simulated: bool = False
    lifecycle: str = "active"
    silent: float = 0.0
    unused: float = 0.0
    b: float = 0.0
    told: Told = field(default_factory=Told)
    last_state: dict[str, float] = field(default_factory=lambda: {"holding": 1.0, "fault": 0.0, "experiment": 0.0})
    diagnoses: dict[str, Diagnosis] = field(default_factory=dict)

    def says(self, part: str, **values: str) -> "Seen":
        self.diagnoses[part] = Diagnosis(0, "", values, 0.0)
        return self

    def now(self, **values: float) -> "Seen":
        self.last_state |= values
        return self

    @property
    def axis(self) -> Axis:
        return cast("Axis", self)


def test_what_was_found_is_read_as_it_is_told_and_shown_as_people_want_it() -> None:
    findings = (
        Finding("", "b", "", "rad", 0.0199902, 2.6e-5),
        Finding("load.inertia", "J_l", "", "kg m^2", 5.012e-4, 4e-6),
        Finding("", "delay", "", "s", why="its standard uncertainty is 0.1 s, more than 0.01"),
        Finding("", "wind-up", "", "rad/(N m)", 1.2e-3, 1e-5),
        Finding("", "loss", "", "", 0.0, 1.4e-3),
    )
    drive = DriveEstimate(0.0199902, Method.IDENTIFY, True, "3.6 s of motion", findings=findings)
    learned = BacklashEstimate(0.02, Method.LOAD_AMPLITUDE, True, "9 cycles")
    told = {"identify": quantities_of(drive), "learn": quantities_of(learned)}
    found = state.found_by(Seen().says("controller: servo", found=json.dumps(told)).axis)
    assert list(found) == ["identify", "learn"]
    for unit, texts in {
        "rad": ["19.990 ± 0.026 mrad", "5.012 ± 0.040 kg cm²", "1.200 ± 0.010 mrad/(N m)", "0 ± 0.0014"],
        "deg": ["1.1454 ± 0.0015 deg", "5.012 ± 0.040 kg cm²", "0.06875 ± 0.00057 deg/(N m)", "0 ± 0.0014"],
        "arcmin": ["68.721 ± 0.089 arcmin", "5.012 ± 0.040 kg cm²", "4.125 ± 0.034 arcmin/(N m)", "0 ± 0.0014"],
    }.items():
        assert [each.text(state.ANGLES[unit]) for each in found["identify"]] == texts
    assert found["learn"][0].text(state.ANGLES["rad"]) == "20 mrad"  # its uncertainty is not known
    for other in ("", "nonsense", "[1]", '{"learn": [["b"]]}'):  # another version's controller
        assert state.found_by(Seen().says("controller: servo", found=other).axis) == {}


@pytest.mark.parametrize(
    ("seen", "word", "step"),
    [
        (Seen(), "active", "learn"),
        (Seen(b=0.02), "active", "identify"),
        (Seen(b=0.02, told=Told(1, {"identified": True})), "active", "move"),
        (Seen().now(holding=0.0), "ready", "learn"),
        (Seen().now(experiment=1.0), "learning", "learn"),
        (Seen(b=0.02).now(experiment=1.0), "learning", "learn"),
        (Seen().now(experiment=2.0), "identifying", "identify"),
        (Seen(lifecycle="inactive"), "inactive", "connect"),
        (Seen(silent=2.0), "no samples", "connect"),
        (Seen(unused=3.1), "no samples", "connect"),  # none that the controller can use
        (Seen(unused=math.nan), "active", "learn"),  # nothing was told yet
        (Seen().now(fault=5.0, holding=0.0), "fault", "connect"),
        (Seen(silent=math.inf, last_state={}), "no samples", "connect"),
        (Seen(present=False, lifecycle="not there").now(fault=5.0), "not there", "connect"),
    ],
)
def test_each_state_has_its_word_and_its_next_step(seen: Seen, word: str, step: str) -> None:
    assert state.state_of(seen.axis, None).word == word
    assert state.step_of(seen.axis) == step


def test_a_fault_is_told_before_its_diagnosis_and_gone_before_it() -> None:
    seen = Seen().now(fault=float(Fault.ENCODERS_DISAGREE))
    assert state.fault_of(seen.axis) == ("ENCODERS_DISAGREE", FAULTS[Fault.ENCODERS_DISAGREE].meaning)
    seen.says("controller: servo", fault_name="ENCODERS_DISAGREE", fault="0.5 rad apart")
    assert state.fault_of(seen.axis) == ("ENCODERS_DISAGREE", "0.5 rad apart")
    assert state.fault_of(seen.now(fault=0.0).axis) == ("", "")
    seen.says("simulator: drive", fault_name="NO_COMMANDS", fault="none for 0.1 s")
    assert state.fault_of(seen.axis) == ("", "")  # another drive's
    seen.simulated = True
    assert state.fault_of(seen.axis) == ("NO_COMMANDS", "none for 0.1 s")


def test_only_what_the_acting_law_uses_is_said() -> None:
    seen = Seen().now(region=1.0, phase=2.0).says("controller: servo", law_in_use="planned")
    assert state.acts(seen.axis) == "law planned: hold"
    seen.says("controller: servo", law_in_use="two_region")
    assert state.acts(seen.axis) == "law two_region: fast gains"
    assert state.acts(seen.now(holding=0.0).axis) == ""


def test_a_result_is_being_computed_once_the_motion_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = state.Run("learn"), Seen()
    monkeypatch.setattr(time, "monotonic", lambda: 7.0)
    run.look(seen.axis)  # it has not begun
    assert state.state_of(seen.axis, run).word == "active"
    run.look(seen.now(experiment=1.0).axis)
    run.look(seen.now(experiment=0.0).axis)
    assert run.computing_since == 7.0
    assert state.state_of(seen.axis, run).word == "computing"


def found_by_identify(*symbols: str) -> str:
    return json.dumps({"identify": [[symbol, 5e-4, 4e-6, "kg m^2"] for symbol in symbols]})


@pytest.mark.parametrize(
    ("symbols", "identified", "result", "gain"),
    [
        ((), False, "the load is not known", "would let law planned act: faster and calmer"),
        (
            ("b", "J_l"),
            False,
            "load found, its dry friction not",
            "try again, then at another angle; law two_region still acts",
        ),
        (("b", "c_l"), False, "load found, its inertia not", "try again, then at another angle"),
        (("b",), False, "the load was not found", "law two_region still acts"),
        (("J_l", "c_l"), False, "load found, but not in use", "law two_region still acts"),  # it was not applied
        (("J_l", "c_l"), True, "load inertia 5.000 ± 0.040 kg cm²", "in use by law two_region"),
        ((), True, "load inertia 5 kg cm²", "in use by law two_region"),  # told by hand
    ],
)
def test_what_identify_did_not_find_is_said_with_what_to_do(
    symbols: tuple[str, ...], result: str, gain: str, *, identified: bool
) -> None:
    seen = Seen(b=0.02, told=Told(1, {"identified": identified, "load.inertia": 5e-4}))
    found = found_by_identify(*symbols) if symbols else ""
    seen.says("controller: servo", law_in_use="two_region", found=found)
    shown = state.of_identification(seen.axis, state.ANGLES["rad"])
    assert shown[0] == result
    assert gain in shown[1]


_HEAVY = "a load with 0.6 of the motor's inertia may rattle: identify, too"


@pytest.mark.parametrize(
    ("inertia", "law", "gain"),
    [
        (5e-4, "two_region", "in use by law two_region"),
        (
            1.2e-3,
            "two_region",
            f"in use by law two_region; {_HEAVY}",
        ),
        (1.2e-3, "planned", "in use by law planned"),
        (1.1e-3, "fast", "law fast does not use it"),
    ],
)
def test_a_heavy_load_asks_for_more_than_the_backlash(inertia: float, law: str, gain: str) -> None:
    told = {**values_of(NOMINAL_DRIVE), "load.inertia": inertia}
    seen = Seen(b=0.02, told=Told(1, told)).says("controller: servo", law_in_use=law)
    assert state.of_learning(seen.axis, state.ANGLES["rad"]) == ("backlash b = 20 mrad", gain)


def test_an_uncertainty_is_told_as_long_as_the_backlash_is_in_use_that_it_belongs_to() -> None:
    """Another experiment without a result, which becomes the last one, changes nothing."""
    found = json.dumps({"learn": [["b", 0.02, 1e-5, "rad"]], "identify": []})
    seen = Seen(b=0.02).says("controller: servo", found=found, estimate_applied="False", estimate_rad="nan")
    assert state.of_learning(seen.axis, state.ANGLES["rad"])[0] == "backlash b = 20.000 ± 0.010 mrad"
    seen.b = 0.021  # set by hand
    assert state.of_learning(seen.axis, state.ANGLES["rad"])[0] == "backlash b = 21 mrad"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("no gap: a flank slips; check both, and try again", "Check both, and try again. Why: no gap: a flank slips"),
        ("no drive moves so: check the units", "Check the units. Why: no drive moves so"),
        ("cancelled on request", "cancelled on request"),
    ],
)
def test_a_remedy_comes_first(text: str, shown: str) -> None:
    assert state.remedy_first(text) == shown


@pytest.mark.parametrize("change", [{"fault": 5.0}, {"experiment": 1.0}, {"holding": 0.0}])
def test_an_answer_is_about_one_situation(change: dict[str, Any]) -> None:
    assert state.situation(Seen().axis) == state.situation(Seen().now(progress=0.5, load_angle=1.0).axis)
    assert state.situation(Seen().axis) != state.situation(Seen().now(**change).axis)


def test_samples_that_the_controller_cannot_use_are_told_with_the_reason_and_soon() -> None:
    seen = Seen(unused=1.1, told=Told(1, {"telemetry_rate": 50.0}))
    said = "no usable joint states"
    assert state.silence(seen.axis) == said
    assert (
        state.silence(seen.says("controller: servo", last_dropped="unusable joint_states: no motor").axis)
        == f"{said}: no motor"
    )
    assert state.refusal(seen.axis) == f"nothing was sent: {said}: no motor"
    assert state.silence(Seen(unused=0.9, told=seen.told).axis) == ""
    slow = Seen(unused=4.0, told=Told(1, {"telemetry_rate": 0.5}))
    assert state.silence(slow.axis) == ""  # it tells of a sample every 2 s


def test_a_simulated_drive_that_waits_after_a_stop_is_no_second_failure() -> None:
    seen = Seen(silent=29.0, lifecycle="inactive")
    assert state.silence(seen.axis) == "no joint states from the drive for 29 s"
    seen.simulated = True
    assert state.silence(seen.axis) == "the simulation waits"


_TRAVEL = {"limits.position_lower": -2.96706, "limits.position_upper": 2.96706, "limits.soft_zone": 0.05}


@pytest.mark.parametrize(
    ("unit", "target", "why"),
    [
        ("rad", 5.0, "5 rad is beyond the travel, ±2.967 rad"),
        ("deg", -3.0, "-171.9 deg is beyond the travel, ±170 deg"),
        ("arcmin", 3.0, "10313 arcmin is beyond the travel, ±10200 arcmin"),
        ("rad", 2.96706, ""),
    ],
)
def test_a_target_beyond_the_travel_is_told(unit: str, target: float, why: str) -> None:
    seen = Seen(told=Told(1, _TRAVEL)).now(reference=0.0)
    assert state.beyond(seen.axis, target, state.ANGLES[unit]).removeprefix("nothing was sent: ") == why


def test_a_leap_that_the_controller_refuses_is_told_and_a_plan_may_go_as_far() -> None:
    told = {"limits.step": 6.28, "profile.mode": "step"}
    why = "nothing was sent: 7 rad is more than limits.step = 6.28 rad away"
    assert state.beyond(Seen(told=Told(1, told)).now(reference=0.0).axis, 7.0, state.ANGLES["rad"]) == why
    told["profile.mode"] = "auto"
    assert state.beyond(Seen(told=Told(1, told)).now(reference=0.0).axis, 7.0, state.ANGLES["rad"]) == ""
    assert state.travel_text(Seen().axis, state.ANGLES["rad"]) == ""


def test_a_load_beyond_its_travel_is_told_with_what_to_do() -> None:
    seen = Seen(told=Told(1, _TRAVEL)).now(load_angle=5.9)
    said = "the load is beyond its travel, ±2.967 rad: go back to an angle within it"
    assert state.outside(seen.axis, state.ANGLES["rad"]) == said
    assert state.outside(seen.now(load_angle=3.0).axis, state.ANGLES["rad"]) == ""  # it overshot the end


def test_the_answer_of_an_experiment_outlives_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may come before the telemetry that says so."""
    label = SimpleNamespace(text="")
    label.set_text = lambda text: setattr(label, "text", text)
    label.classes = label.props = lambda _: label
    monkeypatch.setattr(card.ui, "label", lambda _: label)
    said, seen = card.Said("answer"), Seen().now(experiment=2.0)
    said.tell(seen.axis, Answer(False, "cancelled"))
    for change in ({"experiment": 0.0, "holding": 0.0}, {"holding": 1.0}):
        said.refresh(seen.now(**change).axis)
        assert label.text == "cancelled"
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 2.0)
    said.refresh(seen.axis)
    assert label.text == "cancelled"
    said.refresh(seen.now(experiment=1.0).axis)
    assert label.text == ""
    said.tell(seen.axis, Answer(False, "refused"))
    seen.lifecycle = "inactive"
    said.refresh(seen.axis)
    assert label.text == ""
