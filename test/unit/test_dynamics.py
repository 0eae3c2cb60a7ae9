"""The Jacobian against differences, the methods against each other and against it, and the step control."""

import math
import os
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Contact, Drive, IntegrationError, Plant
from backlash_ros.drivetrain.constants import plant_constants
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.motion import integrator
from backlash_ros.drivetrain.motion.dynamics import Acting, equations_of, is_plain
from backlash_ros.drivetrain.motion.explicit import Step, explicit_with
from backlash_ros.drivetrain.motion.implicit import _error, _solve_stage, implicit_with
from backlash_ros.drivetrain.motion.integrator import (
    ADVANCE_SIGNATURE,
    DEFAULT_TOLERANCE,
    DONE,
    STEP_TOO_SMALL,
    Advance,
    _growth,
    integration_at,
    integration_memory,
    integrator_for,
)
from backlash_ros.drivetrain.motion.series import series_with
from backlash_ros.foundation.quantity import quantities
from backlash_ros.foundation.signals import LOST, SUPPLIED, at_rest

CUBIC = '''
"""Teeth whose stiffness rises with their depth: F = k delta^3 (1 + c ddelta/dt)."""

from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.foundation.compiled import compiled
from backlash_ros.drivetrain.contact import Contact, as_constants
from backlash_ros.foundation.quantity import quantity


@compiled
def cubic_force(constants, half_gap, gap, gap_rate):
    depth, side = abs(gap) - half_gap, 1.0 if gap > 0.0 else -1.0
    if depth <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    k, loss = constants[0], 1.0 + constants[1] * gap_rate * side
    if loss <= 0.0:
        return 0.0, 0.0, 0.0, side * k * depth**3, 3.0 * k * depth**2
    spring = k * depth**3
    return side * spring * loss, 3.0 * k * depth**2 * loss, constants[1] * spring, side * spring, 3.0 * k * depth**2


@compiled
def cubic_energy(constants, half_gap, gap):
    return constants[0] * max(0.0, abs(gap) - half_gap) ** 4 / 4.0


@dataclass(frozen=True)
class CubicContact(Contact):
    section: ClassVar[str] = "contact.cubic"
    force: ClassVar = staticmethod(cubic_force)
    energy: ClassVar = staticmethod(cubic_energy)

    stiffness: float = quantity("force at a depth of 1 m", "N/m^3", above=0, at_most=1e20, default=1e15)
    loss: float = quantity("share of the force for each m/s", "s/m", at_least=0, at_most=100, default=0.5)

    def constants(self, load_radius, mass):
        return as_constants(self.stiffness, self.loss)

    def deflection(self, torque, half_gap, load_radius):
        return (abs(torque) / load_radius / self.stiffness) ** (1 / 3) / load_radius

    def edge_stiffness(self, half_gap, load_radius):
        return self.stiffness * (0.1 * half_gap) ** 2


CONTACTS = {"cubic": CubicContact}
'''


@pytest.fixture(scope="module")
def cubic(tmp_path_factory: pytest.TempPathFactory) -> Iterator[type[Contact]]:
    before = list(CONTACTS)
    file: Path = tmp_path_factory.mktemp("teeth") / "cubic.py"
    file.write_text(CUBIC)
    assert CONTACTS.add(file) == ["cubic"]
    yield CONTACTS["cubic"]
    CONTACTS.keep(before)


LAWS = ["power", "power_no_pull", "elastic", "hunt_crossley", "restitution", "cubic"]


def everything(law: str, interface: str = "voltage") -> Drive:
    """A drive with all that the equations of motion have."""
    return Drive(
        replace(NOMINAL_DRIVE.motor, coulomb_friction=0.02),
        replace(
            NOMINAL_DRIVE.gear,
            contact=CONTACTS[law](),
            efficiency_forward=0.7,
            efficiency_backward=0.4,
            backlash_variation=0.6,
            backlash_cycles=5,
            backlash_phase=0.3,
        ),
        replace(NOMINAL_DRIVE.load, coulomb_friction=0.1, gravity_torque=0.3, gravity_offset=1.0),
        interface,
    )


SLIPS = [(1.0, 1.0), (-1.0, 1.0), (0.0, -1.0), (1.0, 0.0), (0.0, 0.0)]


def states(drive: Drive) -> list[np.ndarray]:
    """Well inside the gap and in contact at either flank, teeth closing and parting, away from every corner."""
    random, rows = np.random.default_rng(3), []
    for s in (-1.15, -1.05, -0.4, 0.4, 1.05, 1.15):
        for omega_l in (-0.3, 0.05, 0.3):
            theta_l = random.uniform(-3, 3)
            half = 0.5e-3 * (1 + 0.6 * math.cos(5 * theta_l + 0.3))
            theta_m = (s * half + 0.05 * theta_l) / 0.005
            rows.append(np.array([theta_m, 8 * omega_l, theta_l, omega_l, random.uniform(-2, 2), 0.1, 0.2]))
    return rows


@pytest.mark.corners(12)
@pytest.mark.parametrize("interface", ["voltage", "current"])
@pytest.mark.parametrize("slips", SLIPS, ids=str)
@pytest.mark.parametrize("law", LAWS)
def test_jacobian_is_the_derivative_of_the_derivative(
    law: str, slips: tuple[float, float], interface: str, cubic: type[Contact]
) -> None:
    drive = everything(law, interface)
    plant, equations = plant_constants(drive), equations_of(drive)
    steps = [1e-8, 1e-5, 1e-9, 1e-6, 1e-5, 1e-5, 1e-5]
    for state in states(drive):
        ours, differences, ends = np.empty((7, 7)), np.empty((7, 7)), np.empty((2, 7))
        equations.jacobian(plant, state, Acting(3.0, 0.2, *slips), ours)
        for k, step in enumerate(steps):
            for end, sign in zip(ends, (1, -1), strict=True):
                moved = state.copy()
                moved[k] += sign * step
                equations.derivative(plant, moved, Acting(3.0, 0.2, *slips), end)
            differences[:, k] = (ends[0] - ends[1]) / (2 * step)
        scale = np.max(np.abs(differences), axis=1, keepdims=True)
        assert np.all(np.abs(ours - differences) < 3e-6 * scale + 1e-4)


@pytest.mark.parametrize("interface", ["voltage", "current"])
@pytest.mark.parametrize("slips", SLIPS, ids=str)
@pytest.mark.parametrize("law", LAWS)
def test_stage_solve_is_that_of_the_jacobian(
    law: str, slips: tuple[float, float], interface: str, cubic: type[Contact]
) -> None:
    drive = everything(law, interface)
    plant, equations = plant_constants(drive), equations_of(drive)
    random = np.random.default_rng(5)
    for state in states(drive):
        for g in (1e2, 1e4, 1e6):
            residual, solved, matrix = random.normal(size=7), np.empty(7), np.empty((7, 7))
            if interface == "current":
                residual[4] = 0.0  # an imposed current does not change
            slopes = equations.linearize(plant, state, *slips)
            _solve_stage(plant, slopes, g, state[4], Acting(3.0, 0.2), residual, solved)
            equations.jacobian(plant, state, Acting(3.0, 0.2, *slips), matrix)
            expected = np.linalg.solve(g * np.eye(7) - matrix, residual)
            np.testing.assert_allclose(solved, expected, rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_stored_energy_and_the_account_agree_at_every_state(law: str, cubic: type[Contact]) -> None:
    """The rate of the stored energy is what is supplied less what is lost, and nothing is gained by loss."""
    drive = everything(law)
    plant, equations = plant_constants(drive), equations_of(drive)
    for state in states(drive):
        rate = np.empty(7)
        slips = math.copysign(1.0, state[1]), math.copysign(1.0, state[3])
        equations.derivative(plant, state, Acting(3.0, 0.2, *slips), rate)
        after, before = (equations.stored_energy(plant, state + time * rate) for time in (1e-8, -1e-8))
        stored = (after - before) / 2e-8
        assert stored == pytest.approx(rate[SUPPLIED] - rate[LOST], rel=1e-5, abs=1e-5)
        assert rate[LOST] >= 0.0


def test_contact_law_from_a_file_integrates_and_keeps_its_energy_account(cubic: type[Contact]) -> None:
    plant = Plant(everything("cubic"), [0.0, 50.0, 0.0, -2.0, 0.3], tolerance=5e-12, account=True)
    before, turnover = plant.energy_stored, 0.0
    for k in range(200):
        supplied = plant.energy_supplied
        plant.advance(6.0 * math.sin(k / 7.0), 0.1 * math.cos(k / 11.0), 0.001)
        turnover += abs(plant.energy_supplied - supplied)
    balance = plant.energy_supplied - plant.energy_lost - (plant.energy_stored - before)
    assert turnover > 0.05
    assert abs(balance) <= 1e-9 * turnover


def test_contact_law_from_a_file_owns_its_parameters(cubic: type[Contact], tmp_path: Path) -> None:
    assert list(quantities(cubic)) == ["stiffness", "loss"]
    with pytest.raises(ValueError, match=r"^contact\.cubic\.loss must be >= 0 s/m and <= 100 s/m, got -1"):
        cubic(loss=-1)
    gear = replace(NOMINAL_DRIVE.gear, contact=cubic())
    assert gear.wind_up(1.0) == pytest.approx((20 / 1e15) ** (1 / 3) / 0.05)
    (tmp_path / "empty.py").write_text('"""Nothing."""\n')
    with pytest.raises(ValueError, match=r"empty\.py must have a table CONTACTS"):
        CONTACTS.add(tmp_path / "empty.py")
    (tmp_path / "again.py").write_text(CUBIC.replace('"cubic": Cubic', '"elastic": Cubic'))
    with pytest.raises(ValueError, match=r"'elastic' in .*again\.py is the name of another entry"):
        CONTACTS.add(tmp_path / "again.py")


def test_plugins_are_there_for_every_process_and_may_import_all_of_the_package(tmp_path: Path) -> None:
    file = tmp_path / "cubic.py"
    file.write_text(f"{CUBIC}\n\nfrom backlash_ros.control import ServoSettings\n")
    command = [sys.executable, "-c", "from backlash_ros.drivetrain import CONTACTS; print(*CONTACTS)"]
    environment = {**os.environ, "BACKLASH_ROS_PLUGINS": str(file)}
    output = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=600).stdout
    assert output.split() == LAWS


def test_one_integrator_for_each_contact_law_of_one_signature() -> None:
    stiff = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=ElasticContact()))
    soft = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=ElasticContact(wind_up=0.1)))
    assert integrator_for(stiff) is integrator_for(soft) is not integrator_for(NOMINAL_DRIVE)
    for drive in (stiff, NOMINAL_DRIVE):
        assert [ADVANCE_SIGNATURE.args] == integrator_for(drive).signatures  # type: ignore[attr-defined]


# The two methods

SMOOTH = np.array([0.0, 8.0, 0.0, 0.8, 0.2, 0.0, 0.0])
"""In the middle of the gap, where the equations have no kink."""


def taken(method: Any, drive: Drive, state: np.ndarray, h: float, parts: int = 1) -> np.ndarray:
    """The state after ``parts`` even steps over ``h`` seconds under 2 V."""
    plant, step = plant_constants(drive), method(type(drive.gear.contact))
    for _ in range(parts):
        out = np.zeros(7)
        step(plant, state, h / parts, Acting(2.0, 0.1), 1e-8, True, out)
        state = out
    return state


@pytest.mark.parametrize(("method", "order", "h"), [(explicit_with, 8, 2e-3), (implicit_with, 4, 1e-4)])
def test_each_method_has_its_order(method: Any, order: int, h: float) -> None:
    """Half the step leaves 2^-order of the error, that of the energies, too."""
    drive = everything("power")
    exact = taken(explicit_with, drive, SMOOTH, h, 64)
    coarse, fine = (np.abs(taken(method, drive, SMOOTH, h, parts) - exact) for parts in (1, 2))
    scale = np.array([1.0, 100.0, 0.1, 10.0, 10.0, 1.0, 1.0])
    assert np.max(coarse / scale) > 1e-12
    assert np.max(fine / scale) < 2.0 ** (0.5 - order) * np.max(coarse / scale) + 1e-15


@pytest.mark.parametrize("s", [0.4, 0.99])
def test_error_of_a_step_is_that_of_its_size(s: float) -> None:
    """As the step is judged, against many short ones: never far below it, and of its order of magnitude."""
    state = SMOOTH.copy()
    state[0] = s * 0.5e-3 / 0.005
    plant, step = plant_constants(NOMINAL_DRIVE), explicit_with(type(NOMINAL_DRIVE.gear.contact))
    for h in (2e-4, 4e-4, 8e-4):
        out = np.zeros(7)
        error, force = step(plant, state, h, Acting(2.0, 0.1), 1.0, False, out)
        exact = taken(explicit_with, NOMINAL_DRIVE, state, h, 64)
        allowed = [0.2, 480.0, 0.02, 48.0, 12.0]
        assert error > 0.3 * np.max(np.abs(out - exact)[:5] / allowed)
        ends = [abs(equations_of(NOMINAL_DRIVE).contact_of(plant, end)[0]) for end in (state, out)]
        assert force >= ends[0]
        assert force <= 1.3 * max(ends)


@pytest.mark.parametrize("huge", [1e20, 1e60, 1e300, math.inf, math.nan])
def test_step_into_nowhere_is_never_accurate_enough(huge: float) -> None:
    """Whatever overflows on the way: a teeth's force of the 21st power soon does."""
    plant = plant_constants(NOMINAL_DRIVE)
    for k in range(5):
        state = SMOOTH.copy()
        state[k] = huge
        for method in (explicit_with, implicit_with):
            step: Step = method(type(NOMINAL_DRIVE.gear.contact))
            error, _ = step(plant, state, 1e-3, Acting(2.0, 0.1), 1e-8, True, np.zeros(7))
            moves = k in (1, 3, 4) and huge == 1e20 and method is implicit_with
            assert moves or not error <= 1.0


def methods_of(drive: Drive, state: np.ndarray, command: float, duration: float) -> tuple[int, int, np.ndarray]:
    """How many steps either method takes, and the state at the end."""
    count = [0, 0]

    def counted(method: Any, which: int) -> Any:
        step = method(type(drive.gear.contact))

        def counting(*arguments: Any) -> Any:
            count[which] += 1
            return step(*arguments)

        return counting

    advance = in_python(drive, _explicit=counted(explicit_with, 0), _implicit=counted(implicit_with, 1))
    memory, plant = integration_memory(), plant_constants(drive)
    for _ in range(20):
        assert advance(plant, state, memory, command, 0.0, duration / 20, DEFAULT_TOLERANCE)[0] == DONE
    return count[0], count[1], state


def test_stiff_motion_is_left_to_the_implicit_method_and_no_other() -> None:
    """A winding that follows within 50 ns does not make steps that short; the nominal drive is not stiff."""
    explicit, implicit, _ = methods_of(NOMINAL_DRIVE, at_rest(), 3.0, 0.1)
    assert explicit > 50
    assert implicit == 0
    quick = replace(NOMINAL_DRIVE, motor=replace(NOMINAL_DRIVE.motor, inductance=1e-7))
    explicit, implicit, state = methods_of(quick, at_rest(), 3.0, 0.1)
    assert 0 < implicit < 2000
    assert explicit < 100
    plant = Plant(quick, tolerance=1e-9)
    plant.advance(3.0, 0.0, 0.1)
    np.testing.assert_allclose(state[:5], plant.state, rtol=1e-5, atol=1e-7)


# Step control


def allowance_of(k: int, value: float = 0.0) -> float:
    """What `_error` lets pass at a tolerance of 1, found from its answer to an error in one component alone."""
    plant, state, difference = plant_constants(NOMINAL_DRIVE), np.zeros(7), np.zeros(7)
    state[k], difference[k] = value, 1.0
    return 1.0 / float(_error(plant, state, difference, True))


def test_each_component_has_an_error_of_its_own() -> None:
    b, speed, energy = 0.02, 24 / 0.05, 0.5 * 2e-5 * 480**2
    full = [b / 0.1, speed, b, 0.1 * speed, 12.0, energy, energy]
    for k, allowed in enumerate(full):
        assert allowance_of(k) == pytest.approx(allowed)
        assert allowance_of(k, 7.0) == pytest.approx(allowed + (7.0 if k > 4 else 0.0))


def test_angles_are_judged_against_the_narrowest_backlash() -> None:
    drive = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, backlash_variation=0.75))
    difference = np.zeros(7)
    difference[2] = 0.005
    assert _error(plant_constants(drive), np.zeros(7), difference, False) == pytest.approx(1.0)


def test_last_step_that_is_cut_short_to_end_on_time_leaves_the_size_as_it_was() -> None:
    advance, memory, plant = integrator_for(NOMINAL_DRIVE), integration_memory(), plant_constants(NOMINAL_DRIVE)
    integration_at(memory).step_size = 1e-5
    assert advance(plant, at_rest(), memory, 0.1, 0.0, 1.0001e-5, 1e-6) == (DONE, 1.0001e-5)
    assert integration_at(memory).step_size >= 1e-5


@pytest.mark.parametrize("k", range(7))
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_state_that_is_not_finite_is_never_accurate_enough(k: int, bad: float) -> None:
    state = np.zeros(7)
    state[k] = bad
    assert _error(plant_constants(NOMINAL_DRIVE), state, np.zeros(7), True) == math.inf


def test_error_that_is_no_number_takes_no_step() -> None:
    state = at_rest()
    state[0] = 0.1  # teeth touch
    touching = state.copy()
    advance, plant = integrator_for(NOMINAL_DRIVE), plant_constants(NOMINAL_DRIVE)
    assert advance(plant, state, integration_memory(), 1.0, 0.0, 0.01, math.nan) == (STEP_TOO_SMALL, 0.0)
    np.testing.assert_array_equal(state, touching)


@pytest.mark.parametrize(("explicit", "order"), [(True, 8), (False, 4)])
def test_step_grows_with_accuracy_but_not_after_a_rejection(explicit: bool, order: int) -> None:
    assert _growth(0.0, False, explicit) == _growth(1e-12, False, explicit) == 6.0
    assert _growth(1e-12, True, explicit) == _growth(0.01, True, explicit) == 1.0
    assert _growth(0.5, False, explicit) == pytest.approx(0.9 * 2 ** (1 / order))
    assert _growth(1.0, True, explicit) == pytest.approx(0.9)
    assert _growth(16.0, False, explicit) == pytest.approx(0.9 * 16 ** (-1 / order))
    assert _growth(1e9, False, explicit) == 0.2
    assert _growth(math.inf, False, explicit) == _growth(math.nan, True, explicit) == 0.1


def in_python(drive: Drive, **others: Any) -> Advance:
    """The integrator as plain Python with its functions bound, or ``others`` in their place."""
    compiled: Any = integrator_for(drive)
    bound = compiled.py_func.__globals__
    run = types.FunctionType(integrator._go.__code__, {**bound["_run"].py_func.__globals__, **others})
    template: Any = integrator._advance
    return types.FunctionType(template.__code__, {**bound, "_run": run, **others})  # type: ignore[return-value]


def watched(drive: Drive) -> tuple[Advance, list[float], list[float], list[float]]:
    """The integrator as plain Python, the lists of the steps that it tries (s) and of their errors, and exact steps."""
    steps: list[float] = []
    errors: list[float] = []
    exact: list[float] = []
    compiled, series = explicit_with(type(drive.gear.contact), is_plain(drive)), series_with(type(drive.gear.contact))

    def explicit(*arguments: Any) -> tuple[float, float]:
        error, force = compiled(*arguments)
        steps.append(arguments[2])
        errors.append(error)
        return error, force

    def exactly(*arguments: Any) -> tuple[float, float]:
        used, force = series(*arguments)
        exact.append(used)
        return used, force

    return in_python(drive, _explicit=explicit, _series=exactly), steps, errors, exact


def test_no_step_that_follows_a_rejection_and_a_success_is_longer_than_that() -> None:
    """Through impacts, which reject steps; and none is taken whose error is too large."""
    advance, steps, errors, exact = watched(NOMINAL_DRIVE)
    state, memory, plant = at_rest(), integration_memory(), plant_constants(NOMINAL_DRIVE)
    state[1] = 50.0
    assert advance(plant, state, memory, 0.0, 0.0, 0.02, 1e-6) == (DONE, 0.02)
    taken = [step for step, error in zip(steps, errors, strict=True) if error <= 1]
    assert sum(taken) + sum(exact) == pytest.approx(0.02)
    braked = grown = 0
    for k in range(len(steps) - 2):
        if errors[k] > 1.0:
            assert steps[k + 1] <= 0.9 * steps[k]
            if errors[k + 1] <= 1.0:
                braked += 1
                assert steps[k + 2] <= steps[k + 1] * (1 + 1e-9)
        elif errors[k + 1] <= 1.0:
            grown += steps[k + 2] > steps[k + 1]
    assert braked > 3
    assert grown > 10
    assert integration_at(memory).step_size > 0.0
    compiled, again = integrator_for(NOMINAL_DRIVE), at_rest()
    again[1] = 50.0
    compiled(plant, again, integration_memory(), 0.0, 0.0, 0.02, 1e-6)
    np.testing.assert_allclose(again, state, rtol=1e-9, atol=1e-12)


def test_largest_force_is_kept_until_the_caller_forgets_it() -> None:
    advance, memory, state = integrator_for(NOMINAL_DRIVE), integration_memory(), at_rest()
    plant, state[1] = plant_constants(NOMINAL_DRIVE), 50.0
    seen = []
    for _ in range(400):
        assert advance(plant, state, memory, 0.0, 0.0, 5e-5, DEFAULT_TOLERANCE)[0] == DONE
        seen.append(abs(equations_of(NOMINAL_DRIVE).contact_of(plant, state)[0]))
    assert max(seen) <= integration_at(memory).peak_force <= 1.5 * max(seen)
    assert max(seen) > 100.0
    integration_at(memory).peak_force = 0.0
    advance(plant, at_rest(), memory, 0.0, 0.0, 1e-3, DEFAULT_TOLERANCE)
    assert integration_at(memory).peak_force == 0.0


@pytest.mark.parametrize("speed", [3.0, 200.0, *(pytest.param(v, marks=pytest.mark.grid) for v in (10.0, 50.0))])
def test_largest_force_between_the_steps_is_seen(speed: float) -> None:
    """An impact in one call, against a look every microsecond: within 0.5 %."""
    advance, plant, contact_of = (
        integrator_for(NOMINAL_DRIVE),
        plant_constants(NOMINAL_DRIVE),
        equations_of(NOMINAL_DRIVE).contact_of,
    )
    once, often, memory, seen = at_rest(), at_rest(), integration_memory(), 0.0
    once[1] = often[1] = speed
    advance(plant, once, memory, 0.0, 0.0, 0.01, DEFAULT_TOLERANCE)
    for _ in range(10000):
        advance(plant, often, integration_memory(), 0.0, 0.0, 1e-6, DEFAULT_TOLERANCE)
        seen = max(seen, abs(contact_of(plant, often)[0]))
    assert integration_at(memory).peak_force == pytest.approx(seen, rel=5e-3)


@pytest.mark.parametrize("part", [{"coulomb_friction": 0.1}, {"gravity_torque": 0.3}])
def test_no_nan_whatever_is_pushed(part: dict[str, Any]) -> None:
    plant = Plant(replace(NOMINAL_DRIVE, load=replace(NOMINAL_DRIVE.load, **part)))
    with pytest.raises(IntegrationError):
        plant.advance(0.0, 1e300, 0.01)
    assert np.all(np.isfinite(plant.state))
