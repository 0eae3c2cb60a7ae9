"""What becomes of an estimate: in use or on offer, kept, answered; disk, parameter and clock are the test's."""

from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest

from backlash_ros.control import BacklashEstimate, Method
from backlash_ros.control.estimates import Answer, DriveIdentity, Estimates, History, KeptEstimate, parse, render
from backlash_ros.control.estimates.applying import PATIENCE
from backlash_ros.control.experiment import DriveEstimate

DRIVE = DriveIdentity("/controller", "motor", "load", 10.0)
DAY = datetime(2026, 3, 29, 1, 30, 7, 123, tzinfo=timezone.utc)
NEXT = "; call apply_estimate to use it"


class Parameter:
    """Parameters, as a node has them; ``value`` is ``backlash_angle``."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"backlash_angle": 0.0}
        self.refusal = ""

    @property
    def value(self) -> float:
        return float(self.values["backlash_angle"])

    def set(self, values: Mapping[str, Any]) -> str:
        if not self.refusal:
            self.values |= values
        return self.refusal


class Slow(Executor):
    """Does what it was given when it is told to."""

    def __init__(self) -> None:
        self.left: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, work: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.left.append((Future(), lambda: work(*args, **kwargs)))
        return self.left[-1][0]

    def go_on(self) -> None:
        future, work = self.left.pop(0)
        try:
            future.set_result(work())
        except Exception as error:
            future.set_exception(error)


def estimate(angle: float = 0.02) -> BacklashEstimate:
    return BacklashEstimate(angle, Method.GAP_PROBE, valid=True, reason="4 s", uncertainty=1e-4)


@pytest.fixture
def parameter() -> Parameter:
    return Parameter()


@pytest.fixture
def disk() -> Slow:
    return Slow()


@pytest.fixture
def estimates(parameter: Parameter, disk: Slow) -> Estimates:
    return Estimates(parameter.set, disk, lambda: DAY)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "estimates.yaml"


def kept(path: Path) -> list[tuple[float, bool]]:
    return [(each.parameters["backlash_angle"], each.applied) for each in parse(path.read_bytes(), DRIVE).estimates]


def test_auto_puts_it_in_use_at_once(estimates: Estimates, parameter: Parameter) -> None:
    estimates.learned(estimate(), "found", 0, apply=True)
    assert parameter.value == 0.02
    assert estimates.poll(0) == Answer("learn", True, "found")
    assert estimates.poll(0) is None
    assert estimates.offer == ""
    assert estimates.apply(0) == (
        "the newest estimate has already been applied: backlash_angle = 0.02 rad; set these parameters to use it again"
    )


def test_ask_offers_it_and_applies_it_once(estimates: Estimates, parameter: Parameter) -> None:
    assert estimates.apply(0).startswith("there is no estimate to apply")
    estimates.learned(estimate(), "found", 0, apply=False)
    assert estimates.poll(0) == Answer("learn", True, f"found{NEXT}")
    assert parameter.value == 0.0
    assert estimates.offer == "an estimate waits for apply_estimate: backlash_angle = 0.02 rad"
    assert estimates.apply(0) == ""
    assert estimates.poll(0) == Answer("apply_estimate", True, "in use: backlash_angle = 0.02 rad")
    assert parameter.value == 0.02
    assert estimates.offer == ""
    assert "has already been applied" in estimates.apply(0)


def test_the_next_one_takes_the_place_of_the_one_on_offer(estimates: Estimates, parameter: Parameter) -> None:
    for angle in (0.02, 0.03):
        estimates.learned(estimate(angle), "found", 0, apply=False)
        estimates.poll(0)
    assert estimates.apply(0) == ""
    assert parameter.value == 0.03


@pytest.mark.parametrize(("angle", "otherwise"), [(0.0203, False), (0.0205, True), (0.0195, True)])
def test_an_estimate_that_contradicts_the_one_before_is_applied_and_says_so(
    estimates: Estimates, parameter: Parameter, disk: Slow, path: Path, angle: float, otherwise: bool
) -> None:
    """By more than three times the standard uncertainty of both, 0.42 mrad, of this run or of the one before."""
    estimates.begin(str(path), DRIVE, use=False)
    for again in (False, True):
        if again:
            estimates.begin(str(path), DRIVE, use=False)
        for value in (angle, 0.02) if again else (0.02, angle):
            estimates.learned(estimate(value), "found", 0, apply=True)
            disk.go_on()
            answer = estimates.poll(0)
            assert answer is not None
            assert answer.success
            said = "backlash_angle was" in answer.text
            assert said == (otherwise and value != (angle if again else 0.02))
    assert parameter.value == 0.02
    if otherwise:
        assert f"backlash_angle was {angle:.6g} rad by gap_probe at 2" in answer.text
        assert "standard uncertainties off" in answer.text


def test_what_the_parameter_refuses_stays_on_offer(estimates: Estimates, parameter: Parameter) -> None:
    parameter.refusal = "the law cannot be designed"
    estimates.learned(estimate(), "found", 0, apply=True)
    assert estimates.poll(0) == Answer("learn", False, "found, but it was refused: the law cannot be designed")
    assert estimates.apply(0) == "backlash_angle = 0.02 rad was refused: the law cannot be designed"
    parameter.refusal = ""
    assert estimates.apply(0) == ""
    assert parameter.value == 0.02


DRIVE_FOUND = DriveEstimate(
    0.0,
    Method.IDENTIFY,
    valid=True,
    reason="4 s of motion",
    drive={"load.inertia": 6e-4, "contact.law": "elastic"},
    deviations={"load.inertia": 5e-6},
)


def test_what_was_found_of_a_drive_is_set_together_and_no_gap_where_none_was_told(
    estimates: Estimates, parameter: Parameter, disk: Slow, path: Path
) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=True)
    disk.go_on()
    estimates.poll(0)
    estimates.learned(DRIVE_FOUND, "found", 0, apply=True, service="identify")
    disk.go_on()
    assert estimates.poll(0) == Answer("identify", True, "found")
    assert parameter.values == {"backlash_angle": 0.02, "load.inertia": 6e-4, "contact.law": "elastic"}
    newest = parse(path.read_bytes(), DRIVE).estimates[-1]
    assert newest.parameters == {"load.inertia": 6e-4, "contact.law": "elastic"}
    assert newest.uncertainties == {"load.inertia": 5e-6}
    parameter.values = {"backlash_angle": 0.0}
    text = estimates.begin(str(path), DRIVE, use=True)
    assert parameter.values == {"backlash_angle": 0.02, "load.inertia": 6e-4, "contact.law": "elastic"}
    assert text.startswith("backlash_angle = 0.02 rad, load.inertia = 0.0006 kg m^2, contact.law = elastic, the newest")


@pytest.mark.parametrize("apply", [True, False])
def test_what_is_out_of_bounds_is_neither_used_nor_offered(
    estimates: Estimates, parameter: Parameter, path: Path, apply: bool
) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    for angle in (0.0, 3.3, float("nan")):
        estimates.learned(estimate(angle), "found", 0, apply=apply)
        answer = estimates.poll(0)
        assert answer is not None
        assert not answer.success
        assert "found, but it was refused: parameters.backlash_angle must be" in answer.text
    assert (parameter.value, estimates.newest) == (0.0, None)
    assert kept(path) == []


def test_the_answer_comes_when_the_file_is_written(estimates: Estimates, disk: Slow, path: Path) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=False)
    assert estimates.poll(PATIENCE - 1) is None
    assert estimates.busy
    assert estimates.apply(0) == "cannot apply: the previous estimate is still being written"
    disk.go_on()
    assert estimates.poll(0) == Answer("learn", True, f"found{NEXT}")
    assert kept(path) == [(0.02, False)]
    estimates.apply(0)
    assert estimates.poll(0) is None
    disk.go_on()
    assert estimates.poll(0) == Answer("apply_estimate", True, "in use: backlash_angle = 0.02 rad")
    assert kept(path) == [(0.02, True)]
    assert (parse(path.read_bytes(), DRIVE).estimates[0].date) == "2026-03-29T01:30:07Z"


def test_every_valid_estimate_is_kept(estimates: Estimates, disk: Slow, path: Path) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    for angle, apply in ((0.02, True), (0.03, False), (0.04, True)):
        estimates.learned(estimate(angle), "found", 0, apply=apply)
        disk.go_on()
        estimates.poll(0)
    assert kept(path) == [(0.02, True), (0.03, False), (0.04, True)]


def test_a_disk_that_hangs_holds_up_no_answer_for_long_and_no_end(estimates: Estimates, disk: Slow, path: Path) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=True)
    assert estimates.poll(PATIENCE) == Answer("learn", True, f"found; it is still being written to {path}")
    assert not estimates.busy
    assert not estimates.finish(0.0)
    estimates.learned(estimate(0.0203), "found", 0, apply=True)
    assert estimates.poll(0, wait_no_more=True) == Answer("learn", True, f"found; it is still being written to {path}")
    with pytest.raises(ValueError, match="the previous estimate is still being written"):
        estimates.begin(str(path), DRIVE, use=True)
    disk.go_on()
    disk.go_on()
    assert estimates.finish(0.0)
    assert estimates.poll(0) is None
    assert kept(path) == [(0.02, True), (0.0203, True)]


def test_a_write_that_fails_is_told_and_the_estimate_is_in_use(
    estimates: Estimates, parameter: Parameter, disk: Slow, path: Path
) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    path.unlink()
    path.mkdir()
    estimates.learned(estimate(), "found", 0, apply=True)
    disk.go_on()
    why = f"it could not be stored in {path}: it is not a regular file"
    assert estimates.poll(0) == Answer("learn", True, f"found; {why}")
    assert estimates.trouble == why
    assert parameter.value == 0.02
    path.rmdir()
    estimates.learned(estimate(0.0203), "found", 0, apply=True)
    disk.go_on()
    assert estimates.poll(0) == Answer("learn", True, "found")
    assert estimates.trouble == ""
    assert kept(path) == [(0.02, True), (0.0203, True)]  # the one before too


def test_a_failure_after_the_answer_is_seen(estimates: Estimates, disk: Slow, path: Path) -> None:
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=True)
    assert estimates.poll(PATIENCE) is not None
    path.write_text("somebody else's")
    disk.go_on()
    assert estimates.poll(PATIENCE) is None
    assert "another program has changed it" in estimates.trouble
    assert path.read_text() == "somebody else's"


def test_clean_up_ends_the_offer_and_the_file_has_it(estimates: Estimates, path: Path) -> None:
    estimates.begin("", DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=False)
    estimates.poll(0)
    estimates.forget()
    assert estimates.offer == ""
    assert estimates.apply(0).startswith("there is no estimate to apply")


def test_the_newest_that_was_applied_is_used_at_the_start(
    estimates: Estimates, parameter: Parameter, path: Path
) -> None:
    used, offered = (
        KeptEstimate(DAY.replace(microsecond=0), Method.GAP_PROBE, {"backlash_angle": angle}, {}, applied=angle == 0.02)
        for angle in (0.02, 0.03)
    )
    path.write_text(render(History(DRIVE, (used, offered))))
    assert estimates.begin(str(path), DRIVE, use=False) == f"estimates are kept in {path}"
    assert parameter.value == 0.0
    text = estimates.begin(str(path), DRIVE, use=True)
    assert text == f"backlash_angle = 0.02 rad, the newest learned 2026-03-29T01:30:07Z by gap_probe, from {path}"
    assert parameter.value == 0.02
    assert estimates.apply(0).startswith("there is no estimate to apply")


def test_without_one_that_was_applied_the_parameter_stays(
    estimates: Estimates, parameter: Parameter, path: Path
) -> None:
    parameter.values["backlash_angle"] = 0.015
    for _ in range(2):  # no file yet, and one without estimates
        text = estimates.begin(str(path), DRIVE, use=True)
        assert text == f"{path} has no applied estimate: the parameters stay as given"
    assert parameter.value == 0.015


def test_what_the_parameter_refuses_at_the_start_is_an_error_that_names_the_file(
    estimates: Estimates, parameter: Parameter, path: Path
) -> None:
    parameter.refusal = "it is unstable"
    path.write_text(
        render(History(DRIVE, (KeptEstimate(DAY, Method.GAP_PROBE, {"backlash_angle": 0.02}, {}, applied=True),)))
    )
    with pytest.raises(ValueError, match=f"{path}: backlash_angle = 0.02 rad: it is unstable"):
        estimates.begin(str(path), DRIVE, use=True)


@pytest.mark.parametrize("use", [True, False])
def test_another_drives_file_is_refused_used_or_not(estimates: Estimates, path: Path, use: bool) -> None:
    path.write_text(render(History(DriveIdentity("/axis2/controller", "motor", "load", 10.0))))
    before = path.read_text()
    with pytest.raises(ValueError, match=r"drive\.controller must be '/controller'"):
        estimates.begin(str(path), DRIVE, use=use)
    assert path.read_text() == before


def test_values_for_the_diagnostics(estimates: Estimates, path: Path) -> None:
    names = ("rad", "uncertainty_rad", "parameters", "method", "learned_at", "applied")
    nothing = {f"estimate_{name}": "" for name in names} | {"estimate_file": ""}
    assert estimates.values() == nothing
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=False)
    assert estimates.values() == {
        "estimate_rad": 0.02,
        "estimate_uncertainty_rad": 1e-4,
        "estimate_parameters": "backlash_angle = 0.02 rad",
        "estimate_method": "gap_probe",
        "estimate_learned_at": "2026-03-29T01:30:07Z",
        "estimate_applied": False,
        "estimate_file": str(path),
    }


def test_by_a_thread_it_is_kept_too(parameter: Parameter, path: Path) -> None:
    estimates = Estimates(parameter.set, ThreadPoolExecutor(1))
    estimates.begin(str(path), DRIVE, use=False)
    estimates.learned(estimate(), "found", 0, apply=True)
    assert estimates.finish(60.0)
    assert kept(path) == [(0.02, True)]
