"""The population: reproducible, within its documented ranges, and told to the controller as the model says."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.optimize import brentq

from backlash_ros.drivetrain import NOMINAL_DRIVE, Effects
from backlash_ros.drivetrain.contacts.hunt_crossley import HuntCrossleyContact
from backlash_ros.studies.evaluation.effects import EFFECTS, MIXTURES, TEETH
from backlash_ros.studies.evaluation.population import Member, draw_member, told_model

MEMBERS = [draw_member(1, number) for number in range(1500)]

FIRST = {
    "gear_reduction": 65.89694565067617,
    "load_inertia": 0.0007476702990856177,
    "load_torque": -0.027986268734429776,
    "sensors_load_counts": 8192.0,
}


def values(name: str) -> np.ndarray:
    return np.array([member.parameters()[name] for member in MEMBERS], dtype=float)


def test_a_seed_and_a_number_are_a_drive_for_good() -> None:
    """What these numbers are is a matter of nothing else: whoever changes them makes old tables void."""
    first = draw_member(1, 0).parameters()
    assert first["gear_reduction"] == pytest.approx(FIRST["gear_reduction"], rel=1e-12)
    assert first["load_inertia"] == pytest.approx(FIRST["load_inertia"], rel=1e-12)
    assert first["load_torque"] == pytest.approx(FIRST["load_torque"], rel=1e-12)
    assert first["sensors_load_counts"] == FIRST["sensors_load_counts"]


def test_other_seeds_and_numbers_are_other_drives() -> None:
    inertias = {draw_member(seed, number).drive.load.inertia for seed in range(10) for number in range(10)}
    assert len(inertias) == 100


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("load_inertia", 5e-4 / 4, 5e-4 * 4),
        ("load_viscous_friction", 5e-3 / 2, 5e-3 * 2),
        ("gear_backlash_angle", 0.02 / 5, 0.02 * 5),
        ("gear_reduction", 5, 200),
        ("motor_resistance", 0.5, 8),
        ("motor_inductance", 0.5e-3, 8e-3),
    ],
)
def test_what_is_drawn_evenly_in_its_logarithm(name: str, low: float, high: float) -> None:
    share = np.log(values(name) / low) / math.log(high / low)
    assert np.all((share >= 0) & (share <= 1))
    assert np.max(np.abs(np.histogram(share, 4, (0, 1))[0] / share.size - 0.25)) < 0.04


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("load_torque", -0.5, 0.5),
        ("load_gravity_torque", 0, 0.3),
        ("gear_backlash_variation", 0, 0.3),
        ("load_coulomb_friction", 0, 0.05 * 24),
        ("motor_coulomb_friction", 0, 0.05 * 24 / 5),
        ("sensors_load_eccentricity", 0, 0.01),
    ],
)
def test_what_one_half_of_the_drives_has(name: str, low: float, high: float) -> None:
    drawn = values(name)
    assert np.all((drawn >= low) & (drawn <= high))
    assert abs(np.mean(drawn == 0) - 0.5) < 0.04


@pytest.mark.parametrize("side", ["load", "motor"])
def test_dry_friction_is_a_share_of_the_stall_torque_at_the_output(side: str) -> None:
    shares = []
    for member in MEMBERS:
        drive = member.drive
        friction = getattr(drive, side).coulomb_friction / (drive.gear.ratio if side == "motor" else 1.0)
        if friction:
            shares.append(friction / drive.standstill_torque())
    assert min(shares) >= 0.001 * (1 - 1e-9)
    assert max(shares) <= 0.05 * (1 + 1e-9)
    assert np.median(shares) == pytest.approx(math.sqrt(0.001 * 0.05), rel=0.15)


def test_eccentricity_is_at_most_a_tenth_of_the_gap() -> None:
    share = values("sensors_load_eccentricity") / values("gear_backlash_angle")
    assert 0.095 < np.max(share) <= 0.1


def test_choices_are_even() -> None:
    for side in ("motor", "load"):
        bits = np.log2(values(f"sensors_{side}_counts"))
        assert set(bits) == set(range(12, 19))
    delays = values("delay_command") * values("rate")
    assert [round(float(np.mean(np.isclose(delays, late))), 1) for late in (0.0, 0.5, 1.0)] == [0.3] * 3
    assert set(values("rate")) == {250.0, 1000.0}
    contacts = [member.parameters()["contact"] for member in MEMBERS]
    assert abs(contacts.count("contact.power") / len(contacts) - 0.5) < 0.04
    assert set(contacts) == {"contact.power", "contact.elastic"}
    assert set(values("torque_change")) == {-0.2, 0.2}


def test_every_reduction_behaves_alike_at_the_output() -> None:
    for member in MEMBERS[:100]:
        drive, nominal = member.drive, NOMINAL_DRIVE
        motor, gear = drive.motor, drive.gear
        assert drive.reflected_inertia == pytest.approx(nominal.reflected_inertia)
        assert motor.viscous_friction / gear.ratio**2 == pytest.approx(2e-3)
        assert motor.torque_constant / gear.ratio == pytest.approx(0.5)
        assert motor.inductance / motor.resistance == pytest.approx(1e-3)


def test_core_is_full_without_what_makes_it_hard() -> None:
    for number in range(50):
        full, core = draw_member(1, number), draw_member(1, number, "core")
        drive = core.drive
        assert drive.motor == NOMINAL_DRIVE.motor
        assert drive.gear.reduction == 10
        assert drive.gear.backlash_variation == drive.load.gravity_torque == core.sensors.load_eccentricity == 0
        assert drive.gear.backlash_angle == full.drive.gear.backlash_angle
        assert drive.load.inertia == full.drive.load.inertia
        assert (core.load_torque, core.rate, core.delay) == (full.load_torque, full.rate, full.delay)
        assert bool(drive.load.coulomb_friction) == bool(full.drive.load.coulomb_friction)


def test_the_nominal_model_is_the_data_sheet_and_the_nominal_load() -> None:
    member = next(member for member in MEMBERS if member.drive.motor.coulomb_friction and member.load_torque)
    model = told_model(member, "nominal")
    assert model.load == NOMINAL_DRIVE.load
    assert model.motor == replace(member.drive.motor, coulomb_friction=0.0)
    assert model.gear == replace(NOMINAL_DRIVE.gear, reduction=member.drive.gear.reduction)
    assert told_model(member, "true") == member.drive


def test_no_controller_is_told_of_an_effect() -> None:
    """Nor of the motor as it is built, unless it is told everything."""
    member = draw_member(1, 3, "core", effects=("datasheet", "cogging"))
    plain = draw_member(1, 3, "core")
    assert told_model(member, "nominal") == told_model(plain, "nominal")
    true = told_model(member, "true")
    assert true.effects == Effects()
    assert true.motor == member.drive.as_built.motor
    assert true.motor != plain.drive.motor


def quarter(member: Member) -> float:
    """Return how far T_s/4 winds the teeth up, as a share of the gap."""
    drive = member.drive
    return drive.gear.wind_up(0.25 * drive.standstill_torque()) / drive.gear.backlash_angle


def left(member: Member) -> float:
    """Return which share of its speed an impact leaves, at the speed that T_s/4 gives the motor over the gap."""
    drive, contact = member.drive, cast("HuntCrossleyContact", member.drive.gear.contact)
    speed = math.sqrt(0.5 * drive.gear.backlash_angle * drive.standstill_torque() / drive.reflected_inertia)
    x = contact.dissipation * speed
    return float(brentq(lambda y: x - math.log1p(x) + y + math.log1p(-y), 1e-9, 1 - 1e-12)) / x


SIZES: dict[str, list[tuple[Callable[[Member], float], float, float]]] = {
    "lively": [(quarter, 0.02, 0.1), (left, 0.6, 0.9)],
    "hertz": [(quarter, 0.05, 0.2), (left, 0.6, 0.9)],
    "soft": [(quarter, 0.3, 0.3)],
    "cogging": [
        (lambda m: m.drive.effects.cogging / m.drive.gear.ratio / m.drive.standstill_torque(), 0.005, 0.015),
        (lambda m: m.drive.effects.cogging_cycles, 7, 24),
    ],
    "ripple": [(lambda m: m.drive.effects.torque_ripple, 0.015, 0.045)],
    "stribeck": [
        (lambda m: m.drive.effects.static_friction, 1.2, 2.0),
        (lambda m: m.drive.effects.stribeck_speed, 0.05, 0.2),
        (lambda m: m.drive.load.coulomb_friction / m.drive.standstill_torque(), 0.003, 0.03),
        (
            lambda m: m.drive.motor.coulomb_friction / m.drive.gear.ratio / m.drive.standstill_torque(),
            *(0.003, 0.03),
        ),
    ],
    "direction": [(lambda m: m.drive.effects.friction_asymmetry, -0.3, 0.3)],
    "datasheet": [
        (lambda m: m.drive.effects.resistance_error, -0.05, 0.2),
        (lambda m: m.drive.effects.torque_constant_error, -0.07, 0.05),
        (lambda m: m.drive.effects.inertia_error, -0.05, 0.15),
        (lambda m: m.drive.effects.inductance_error, -0.2, 0.2),
    ],
    "dead_band": [(lambda m: m.drive.effects.dead_band, 0.003, 0.01)],
    "supply": [
        (lambda m: m.drive.effects.supply_sag, 0.03, 0.09),
        (lambda m: m.drive.effects.command_bits, 8, 12),
    ],
    "encoders": [
        (lambda m: m.sensors.motor_eccentricity, 2e-3, 2e-3),
        (lambda m: m.sensors.load_eccentricity, 3e-4, 5e-4),
        (lambda m: m.sensors.load_ellipticity, 3e-4, 5e-4),
    ],
    "losses": [
        (lambda m: m.drive.gear.efficiency_forward, 0.7, 0.97),
        (lambda m: m.drive.gear.efficiency_backward, 2 - 1 / 0.7, 2 - 1 / 0.97),
    ],
    "worm": [
        (lambda m: m.drive.gear.efficiency_forward, 0.35, 0.35),
        (lambda m: m.drive.gear.efficiency_backward, 0.0, 0.0),
    ],
    "flexible": [
        (lambda m: m.drive.effects.outer_share, 0.4, 0.4),
        (lambda m: m.drive.effects.outer_frequency, 15.0, 60.0),
    ],
    "two_stages": [(lambda m: m.drive.effects.first_gap, 0.6, 0.6)],
    "jitter": [(lambda m: m.delay.stamp_jitter * m.rate, 0.1, 0.1)],
    "drift": [
        (lambda m: m.drive.effects.gap_growth, 0.1, 0.1),
        (lambda m: m.drive.effects.friction_fall, 0.3, 0.3),
    ],
}
"""What an effect sets, and in which bounds: the table of docs/evaluation.md."""


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_are_as_large_as_the_page_says(name: str) -> None:
    members = [draw_member(2, number, "core", effects=(name,)) for number in range(200)]
    for size, low, high in SIZES[name]:
        drawn = np.array([size(member) for member in members], dtype=float)
        assert np.all(drawn >= low - 1e-9 * abs(low))
        assert np.all(drawn <= high + 1e-9 * abs(high))
        assert np.ptp(drawn) >= 0.9 * (high - low)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_changes_nothing_else(name: str) -> None:
    """Drawn by itself: the same alone, beside another effect, and whatever the others draw."""
    other = "drift" if name != "drift" else "cogging"
    alone, both = (draw_member(2, 7, "core", effects=names) for names in ((name,), (other, name)))
    for size, _, _ in SIZES[name]:
        assert size(alone) == size(both)
    plain = draw_member(2, 7, "core")
    assert (alone.load_torque, alone.rate, alone.drive.load.inertia) == (
        *(plain.load_torque, plain.rate),
        plain.drive.load.inertia,
    )


@pytest.mark.parametrize("population", MIXTURES)
def test_half_of_a_mixture_has_each_effect_and_at_most_one_kind_of_teeth(population: str) -> None:
    members = [draw_member(3, number, population) for number in range(600)]
    for name in MIXTURES[population]:
        share = float(np.mean([name in member.effects for member in members]))
        rivals = sum(teeth in MIXTURES[population] for teeth in TEETH)
        expected = (1 - 0.5**rivals) / rivals if name in TEETH else 0.5
        assert share == pytest.approx(expected, abs=0.07)
    assert {name for member in members for name in member.effects} == set(MIXTURES[population])
    assert max(sum(name in TEETH for name in member.effects) for member in members) == 1
    base = "full" if population == "wild" else "core"
    for member in members[:50]:
        assert member.drive.load.inertia == draw_member(3, member.number, base).drive.load.inertia


def test_unknown_populations_and_effects_are_refused() -> None:
    with pytest.raises(ValueError, match=r"population must be one of .*, got 'tame'"):
        draw_member(1, 0, "tame")
    with pytest.raises(ValueError, match=r"effects must be of .*, got 'coging'"):
        draw_member(1, 0, "core", effects=("coging",))


def test_gap_that_is_judged_is_the_one_that_has_grown() -> None:
    member = draw_member(1, 0, "core", effects=("drift",))
    angle = member.drive.gear.backlash_angle
    assert member.gap_at(0.3, 0.0) == pytest.approx(angle)
    assert member.gap_at(0.3, 300.0) == pytest.approx(1.05 * angle)
    assert member.gap_at(0.3, 6000.0) == pytest.approx(1.1 * angle)


def test_motor_that_is_built_is_the_one_that_outruns() -> None:
    member = replace(MEMBERS[0], drive=NOMINAL_DRIVE, load_torque=1.14)
    weaker = replace(member, drive=replace(NOMINAL_DRIVE, effects=Effects(resistance_error=0.2)))
    assert member.can_outrun
    assert not weaker.can_outrun


def test_which_encoders_there_are() -> None:
    both, load, motor = (draw_member(1, 0, encoders=encoders) for encoders in ("both", "load", "motor"))
    assert [member.sensors.measured for member in (both, load, motor)] == [
        ("theta_m", "theta_l"),
        ("theta_l",),
        ("theta_m",),
    ]
    assert both.load_count == load.load_count == 2 * math.pi / both.sensors.load_counts
    assert motor.load_count == 2 * math.pi / motor.sensors.motor_counts * motor.drive.gear.ratio


def outrun(torque: float, resistance: float = 2.0) -> bool:
    drive = replace(NOMINAL_DRIVE, motor=replace(NOMINAL_DRIVE.motor, resistance=resistance))
    member: Member = replace(MEMBERS[0], drive=drive, load_torque=torque)
    return member.can_outrun


def test_a_load_that_accelerates_faster_than_the_motor_cannot_be_outrun() -> None:
    """1.2 J_r a + 0.5 N m within 6 N m, J_r = 4 J_l: up to 5.5/4.8 N m."""
    assert outrun(0.0)
    assert outrun(-1.14)
    assert not outrun(1.15)
    assert not outrun(0.0, resistance=25.0)


def test_a_population_around_another_drive_keeps_its_motor_and_its_scale() -> None:
    strong = replace(NOMINAL_DRIVE, motor=replace(NOMINAL_DRIVE.motor, resistance=0.2))
    for number in range(20):
        ours, nominal = draw_member(1, number, around=strong), draw_member(1, number)
        assert replace(ours.drive.motor, coulomb_friction=0.0) == strong.motor
        assert ours.drive.gear.reduction == 10
        assert ours.load_torque == pytest.approx(10 * nominal.load_torque)
        assert ours.drive.load.inertia == nominal.drive.load.inertia
