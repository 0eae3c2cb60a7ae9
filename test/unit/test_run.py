"""What a run offers in Python: figures in a line and in a table, a picture, a data frame."""

import sys
from collections.abc import Iterator

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex

from backlash_ros.control import BacklashEstimate, GainSet, Method, Polynomials, ServoSettings
from backlash_ros.drivetrain import NOMINAL_DRIVE
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import THETA_L, THETA_M
from backlash_ros.simulation import Run, Scenario, run
from backlash_ros.simulation.colours import LIGHT

GEAR = NOMINAL_DRIVE.gear
COUNT = 250
COLUMNS = {
    "reference": "rad",
    "load": "rad",
    "load_velocity": "rad/s",
    "motor": "rad",
    "motor_velocity": "rad/s",
    "current": "A",
    "gap": "m",
    "command": "V",
    "region": "",
    "load_torque_estimate": "N m",
    "peak_force": "N",
    "measured_load": "rad",
}


@pytest.fixture(scope="module")
def quiet() -> Run:
    return step()


@pytest.fixture(autouse=True)
def _no_figures_left() -> Iterator[None]:
    yield
    plt.close("all")


def step(scenario: Scenario | None = None) -> Run:
    settings = ServoSettings(GainSet.of(NOMINAL_DRIVE), backlash_angle=GEAR.backlash_angle)
    return run(NOMINAL_DRIVE, settings, scenario or Scenario(np.ones(COUNT), substeps=4))


def test_the_gap_is_a_property_like_its_neighbours(quiet: Run) -> None:
    np.testing.assert_array_equal(quiet.load_angle, quiet.state[:, THETA_L])
    np.testing.assert_array_equal(quiet.motor_angle, quiet.state[:, THETA_M])
    expected = GEAR.motor_radius * quiet.motor_angle - GEAR.load_radius * quiet.load_angle
    np.testing.assert_array_equal(quiet.gap, expected)
    assert 0.5 * GEAR.backlash < np.max(quiet.gap) < 0.6 * GEAR.backlash


def test_the_setpoint_is_the_reference_and_the_error_counts_from_it(quiet: Run) -> None:
    np.testing.assert_array_equal(quiet.setpoint, np.ones(COUNT))
    np.testing.assert_array_equal(quiet.error, quiet.load_angle - 1.0)
    moved = step(Scenario(np.r_[np.zeros(100), np.ones(150)], substeps=3))
    assert moved.error[300] == moved.load_angle[300] - 1.0
    assert moved.error[299] == moved.load_angle[299]


def test_the_setpoint_of_a_plan_is_the_plan() -> None:
    ramp = Polynomials(np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5]]))
    planned = step(Scenario(np.zeros(COUNT), source=ramp, substeps=2))
    time = np.arange(COUNT) * 0.004
    np.testing.assert_allclose(planned.setpoint, np.minimum(time, 0.5), atol=1e-12)
    assert np.max(np.abs(planned.error)) < 0.1


def test_a_run_says_law_length_end_and_fault_in_one_line(quiet: Run) -> None:
    said = repr(quiet)
    assert said.startswith("Run(two_region: 1 s, 250 samples at 250 Hz; load at ")
    assert said.endswith(" b from its setpoint; fault: none)")
    assert len(said) < 160


def test_a_notebook_shows_the_figures_and_escapes_a_fault(quiet: Run) -> None:
    shown = quiet._repr_html_()
    assert "<td>1 s, 250 samples at 250 Hz</td>" in shown
    assert "largest command</th><td>24 V<" in shown
    faulted = Run(**{**vars(quiet), "fault": "LOAD_SPEED: 9 > 8", "fault_sample": 3})
    assert "LOAD_SPEED: 9 &gt; 8" in faulted._repr_html_()
    assert "fault: LOAD_SPEED" in repr(faulted)


def test_a_run_without_samples_can_be_shown() -> None:
    empty = step(Scenario(np.empty(0)))
    assert repr(empty) == "Run(two_region: no samples)"
    assert "no samples" in empty._repr_html_()


def test_the_table_has_one_row_for_each_sample_and_a_unit_for_each_column(quiet: Run) -> None:
    table = quiet.table()
    assert {name: unit for name, (unit, _) in table.items()} == {"time": "s", **COLUMNS}
    assert {values.shape for _, values in table.values()} == {(COUNT,)}
    np.testing.assert_array_equal(table["time"][1], quiet.time[:-1:4])
    np.testing.assert_array_equal(table["motor"][1], quiet.motor_angle[:-1:4])
    np.testing.assert_array_equal(table["gap"][1], quiet.gap[:-1:4])


def test_the_data_frame_is_the_table_over_time(quiet: Run) -> None:
    pytest.importorskip("pandas")
    frame = quiet.to_frame()
    assert frame.index.name == "time"
    assert list(frame.columns) == list(COLUMNS)
    assert frame.attrs["units"] == {"time": "s", **COLUMNS}
    for name in COLUMNS:
        np.testing.assert_array_equal(frame[name].to_numpy(), quiet.table()[name][1])


def test_without_pandas_the_package_to_install_is_named(quiet: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"needs pandas: pip install 'backlash_ros\[tables\]'"):
        quiet.to_frame()


def test_a_picture_has_load_motor_setpoint_gap_and_command_in_their_units(quiet: Run) -> None:
    figure = quiet.plot()
    whole, near, gap, command = figure.axes
    names = {line.get_label(): to_hex(line.get_color()) for line in whole.lines}
    assert names == {
        "motor, through the gear": LIGHT["motor"],
        "load": LIGHT["load"],
        "setpoint": LIGHT["ink"],
    }
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "angle at the output, rad",
        "load from setpoint, b",
        "motor in the gap, b",
        "command, V",
    ]
    assert command.get_xlabel() == "time, s"
    drawn = {axes: [line.get_ydata() for line in axes.lines] for axes in (near, gap, command)}
    assert any(np.array_equal(ys, quiet.error / GEAR.backlash_angle) for ys in drawn[near])
    assert any(np.array_equal(ys, quiet.gap / GEAR.backlash) for ys in drawn[gap])
    assert any(np.array_equal(ys, quiet.command) for ys in drawn[command])


def test_a_picture_names_the_fault_and_where_it_was_latched(quiet: Run) -> None:
    faulted = Run(**{**vars(quiet), "fault": "LOAD_SPEED: too fast", "fault_sample": 50})
    for axes in faulted.plot().axes:
        assert any(np.allclose(line.get_xdata(), 0.2) for line in axes.lines)
    assert "LOAD_SPEED" in faulted.plot().axes[0].get_title(loc="left")


def test_a_picture_changes_no_setting_of_its_user(quiet: Run) -> None:
    before = dict(mpl.rcParams)
    quiet.plot()
    assert dict(mpl.rcParams) == before


def test_a_notebook_shows_a_picture_once(quiet: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """It shows what pyplot still holds when a cell ends, beside the figure that the cell returns."""
    quiet.plot()
    assert plt.get_fignums()
    plt.close("all")
    monkeypatch.setattr(mpl, "get_backend", lambda: "inline")
    assert len(quiet.plot().axes) == 4
    assert not plt.get_fignums()


def test_what_an_encoder_does_not_show_is_not_in_the_table() -> None:
    table = step(Scenario(np.ones(10), sensors=Sensors(measured=("theta_m",)))).table()
    assert np.all(np.isnan(table["measured_load"][1]))


@pytest.mark.parametrize(
    ("valid", "says"),
    [(True, ("0.02 ± 3e-05 rad", "from</th><td>motion")), (False, ("none", "because</th><td>motion"))],
)
def test_a_notebook_shows_what_was_learned_or_why_nothing_was(valid: bool, says: tuple[str, ...]) -> None:
    learned = BacklashEstimate(0.02, Method.GAP_PROBE, valid=valid, reason="motion", uncertainty=2.6e-5)
    for each in (*says, "gap_probe"):
        assert each in learned._repr_html_()
