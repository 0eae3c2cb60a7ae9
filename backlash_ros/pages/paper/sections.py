"""What the page of the paper says of each of its claims: the claim, what was computed, and the verdict."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from backlash_ros.studies.paper import FRICTION_TRIED

QUIET = 0.05
"""Residual swing, peak to peak in backlashes, below which a response counts as at rest."""
CLOSE = 0.15
"""Largest relative error of a prediction that holds."""
Numbers = Mapping[str, Any]
"""What `paper.reproduce` computed, as figures.json holds it."""


@dataclass(frozen=True)
class Section:
    """A claim, what was computed, and the verdict: ``holds``, ``holds in part`` or ``does not hold``, with its detail.

    ``title`` begins with the paper's figures, if any, up to a colon; ``short`` is the claim in few words.
    """

    title: str
    figure: str
    short: str
    claim: str
    computed: str
    verdict: str
    detail: str = ""

    @property
    def shown(self) -> str:
        """The figures of the paper that it is about."""
        shown, colon, _ = self.title.partition(": ")
        return shown if colon else "beyond the paper"

    @property
    def anchor(self) -> str:
        """What a link to it leads to."""
        return re.sub(r"[^\w\- ]", "", self.title.lower()).replace(" ", "-")


def sections_of(numbers: Numbers) -> list[Section]:
    """Return the sections in the order of the page."""
    return [section(numbers) for section in _SECTIONS]


def varied_rows(numbers: Numbers) -> dict[str, Mapping[str, Any]]:
    """Return the rows of the adaptive law on other drives by name."""
    varied = numbers["variations"]
    return {f"{title}: {name}": row for title, part in varied.items() for name, row in part.items()}


def _nominal(numbers: Numbers) -> dict[str, Mapping[str, Any]]:
    """Return the row of each law on the nominal drive."""
    return {law: row["nominal"] for law, row in numbers["table"].items()}


def _is_at_rest(row: Mapping[str, Any]) -> bool:
    return bool(row["residual_b"] < QUIET)


def _percent(part: float, whole: float) -> str:
    return f"{100 * (part / whole - 1):+.0f} %"


def _verdict(parts: Sequence[bool]) -> str:
    return "holds" if all(parts) else "holds in part" if any(parts) else "does not hold"


def _all_within(ratios: Sequence[float]) -> bool:
    return all(abs(ratio - 1) < CLOSE for ratio in ratios)


def _since(ratios: Sequence[float], text: str) -> str:
    return text.format(f"{min(ratios):g}", f"{max(ratios):g}") if ratios else "at no ratio tried"


def _open_loop(numbers: Numbers) -> Section:
    """Fig 7: open loop."""
    pushed = numbers["open_loop"]
    return Section(
        "Fig. 7: reaction force, gap and relative speed in open loop",
        "fig07_open_loop",
        "in open loop the teeth rest at ±d/2, and hit hard when they change sides",
        "Under a sinusoidal motor torque and a constant load torque the gap stays near ±d/2, the relative speed is zero but for"
        " the contacts, and the force is large at contact and follows the torque otherwise.",
        f"The teeth touch for {100 * pushed['share_of_time_touching']:.0f} % of the time; while they do, the relative speed is"
        f" {1e3 * pushed['median_relative_speed_touching']:.1f} mm/s in the median against"
        f" {1e3 * pushed['largest_relative_speed']:.0f} mm/s at most, and the force"
        f" {pushed['median_force_touching_N']:.1f} N in the median against {pushed['largest_force_N']:.1f} N at impact.",
        _verdict(
            [
                pushed["median_relative_speed_touching"] < 0.05 * pushed["largest_relative_speed"],
                pushed["largest_force_N"] > 3 * pushed["median_force_touching_N"],
            ]
        ),
    )


def _limit_cycle(numbers: Numbers) -> Section:
    """Figs 3 and 4: the limit cycle."""
    fast, sweep, inertia = _nominal(numbers)["fast"], numbers["backlash_sweep"], numbers["inertia_sweep"]
    amplitudes = [row["amplitude_b"] for row in sweep]
    close = [row["inertia_ratio"] for row in inertia if abs(row["amplitude_b"] - 1) < CLOSE]
    return Section(
        "Figs. 3 and 4: state feedback keeps a limit cycle, as wide as the backlash",
        "fig04_limit_cycle",
        "linear state feedback keeps a limit cycle as wide as the backlash",
        "A linear state feedback removes the big error only; around the target the load oscillates, with an amplitude very close to"
        " the backlash.",
        f"The fast gains keep a cycle of {fast['residual_b']:.2f} b. Over a backlash of {1e3 * sweep[0]['backlash_m']:g} to"
        f" {1e3 * sweep[-1]['backlash_m']:g} mm the amplitude is {min(amplitudes):.2f} to {max(amplitudes):.2f} b: in proportion to the"
        f" backlash, but the load's share of it (next section).",
        _verdict([fast["residual_b"] > 0.5, len(close) == len(inertia)]),
        f"the load {'oscillates' if fast['residual_b'] > 0.5 else 'comes to rest'}; its amplitude is within 15 % of the backlash "
        + _since(close, "for J_r/J_l from {} to {} of the ratios tried below, not beyond"),
    )


def _share(numbers: Numbers) -> Section:
    """Beyond the paper: the share of the gap that the load crosses."""
    inertia = numbers["inertia_sweep"]
    shares = [row for row in inertia if row["amplitude_b"]]
    worst = max(shares, key=lambda row: abs(row["amplitude_b"] / row["share"] - 1))
    silent = [row for row in inertia if not row["amplitude_b"]]
    close = [row["inertia_ratio"] for row in shares if abs(row["amplitude_b"] / row["share"] - 1) < CLOSE]
    return Section(
        "The load's share of the gap",
        "momentum_share",
        "the cycle is as wide as the load's share of the gap, J_r/(J_r + J_l)",
        "(Not in the paper, which takes the amplitude for the backlash.) By momentum exchange the load crosses J_r/(J_r + J_l) of"
        " the gap.",
        f"Simulated cycles have"
        f" {shares[0]['amplitude_b']:.2f} b at J_r/J_l = {shares[0]['inertia_ratio']:g} and {shares[-1]['amplitude_b']:.2f} b at"
        f" {shares[-1]['inertia_ratio']:g}. The share falls short by up to {100 * (worst['amplitude_b'] / worst['share'] - 1):.0f} %, at"
        f" J_r/J_l = {worst['inertia_ratio']:g}, where both inertias move on together while the teeth touch."
        + (
            f" At J_r/J_l = {silent[0]['inertia_ratio']:g} the loop comes to rest and there is nothing to measure."
            if silent
            else ""
        ),
        _verdict([row["inertia_ratio"] in close for row in shares]),
        "the share is within 15 % of the amplitude " + _since(close, "for J_r/J_l from {} to {}"),
    )


def _overdamped(numbers: Numbers) -> Section:
    """Fig 5: slow gains."""
    fast, slow = (_nominal(numbers)[law] for law in ("fast", "overdamped"))
    return Section(
        "Fig. 5: the over-damped regulator",
        "fig05_overdamped",
        "an over-damped regulator is quiet, but slow",
        "An over-damped regulator does not oscillate, but its rise time is large.",
        f"Residual {slow['residual_b']:.3f} b, rise time {slow['rise_time_s']:.3f} s:"
        f" {slow['rise_time_s'] / fast['rise_time_s']:.1f} times that of the fast gains.",
        _verdict([_is_at_rest(slow), slow["rise_time_s"] > 2 * fast["rise_time_s"]]),
    )


def _adaptive(numbers: Numbers) -> Section:
    """Figs 6 and 9: the adaptive law."""
    fast, both = (_nominal(numbers)[law] for law in ("fast", "two_region"))
    sweep = numbers["backlash_sweep"]
    errors = [abs(row["learned_both_encoders_b"] - 1) for row in sweep]
    alone = [abs(row["learned_load_encoder_b"] - 1) for row in sweep if row["learned_load_encoder_b"]]
    raw = [abs(row["load_amplitude_when_learning_b"] - 1) for row in sweep if row["load_amplitude_when_learning_b"]]
    adaptive = [
        _is_at_rest(both),
        both["rise_time_s"] < 1.05 * fast["rise_time_s"],
        both["impacts_after_switch"] <= 2,
    ]
    return Section(
        "Figs. 6 and 9: the learning unit and the adaptive law",
        "fig09_adaptive",
        "the backlash is learned from the amplitude; with it the adaptive law is fast and comes to rest",
        "The learning unit finds the backlash from the amplitude of the oscillations; with it the adaptive law is as fast as the fast"
        " regulator, has one or two impacts after the switch, and is stable then.",
        f"Rise time {both['rise_time_s']:.3f} s against {fast['rise_time_s']:.3f} s, residual {both['residual_b']:.3f} b, overshoot"
        f" {both['overshoot_b']:.2f} b, {both['impacts_after_switch']} impacts after the switch. The backlash is learned to within"
        f" {100 * max(errors):.0f} % with both encoders and {100 * max(alone):.0f} % with the load encoder and the inertias; the bare"
        f" amplitude, as in the paper, is off by up to {100 * max(raw):.0f} %.",
        _verdict([*adaptive, max(raw) < CLOSE]),
        f"the law {'does what is claimed' if all(adaptive) else 'does not do all that is claimed'}; the bare amplitude"
        f" {'is' if max(raw) < CLOSE else 'is not'} within 15 % of the backlash",
    )


def _linear(numbers: Numbers) -> Section:
    """Fig 10: a linear compensator."""
    table = numbers["table"]
    linear, both = (_nominal(numbers)[law] for law in ("elastic_lqg", "two_region"))
    return Section(
        "Fig. 10: against a linear compensator",
        "fig10_linear_compensator",
        "a linear compensator is slightly faster and comes to rest, but overshoots",
        "Mohan's linear controller removes the limit cycle too and traverses the backlash slightly faster, but overshoots; the adaptive"
        " law does not.",
        "Only the abstract and a step response of that controller are known; this is a reconstruction with those properties (LQG for the"
        " elastic two-mass model, from the load's angle alone, with a lead on the reference), not the original, so that"
        " the comparison says what such a controller does and no more. It rises in"
        f" {linear['rise_time_s']:.3f} s ({_percent(linear['rise_time_s'], both['rise_time_s'])} to the adaptive law), overshoots by"
        f" {linear['overshoot_b']:.1f} b (adaptive: {both['overshoot_b']:.2f} b) and leaves {linear['residual_b']:.3f} b. Under load"
        f" inertia x4 it keeps {table['elastic_lqg']['load inertia x4']['residual_b']:.2f} b.",
        _verdict(
            [
                _is_at_rest(linear),
                linear["rise_time_s"] < both["rise_time_s"],
                linear["overshoot_b"] > both["overshoot_b"] + 0.1,
            ]
        ),
    )


def _noise(numbers: Numbers) -> Section:
    """Fig 11: noise."""
    noisy, coarse = (numbers["table"]["two_region"][case] for case in ("1 % noise", "12-bit encoders"))
    return Section(
        "Fig. 11: noise",
        "fig11_noise",
        "noise of 1 % on the measured angle hardly matters",
        "Noise of 1 % of the signal on the measured angle hardly changes the response.",
        f"With ±10 mrad of uniform noise, half the backlash, the residual is {noisy['residual_b']:.3f} b, the overshoot"
        f" {noisy['overshoot_b']:.2f} b. With 12-bit encoders and speeds from them: {coarse['residual_b']:.3f} b.",
        _verdict([_is_at_rest(noisy)]),
    )


def _robustness(numbers: Numbers) -> Section:
    """Fig 12: other drives."""
    varied = numbers["variations"]
    rows = varied_rows(numbers)
    inertias = varied["moment of inertia"]
    failing = [name for name, row in rows.items() if not _is_at_rest(row)]
    heavy = varied["where it fails"]["load inertia x4"]
    claimed = {title: part for title, part in varied.items() if title != "where it fails"}
    held = {title: all(_is_at_rest(row) for row in part.values()) for title, part in claimed.items()}
    return Section(
        "Fig. 12: robustness",
        "fig12_robustness",
        "other inertia, friction, backlash and load torque do not matter",
        "Variations of inertia, viscous friction, backlash (x5) and load torque (0.1 to 0.5 N m) do not have noticeable effects.",
        f"At rest at the end in {len(rows) - len(failing)} of {len(rows)} cases; not at rest: {', '.join(failing) or 'none'}. With twice"
        f" the load inertia the load still drifts across the gap ({inertias['load inertia x2']['residual_b']:.2f} b in the last second);"
        f" with four times it keeps a slow cycle of {heavy['residual_b']:.2f} b.",
        _verdict(list(held.values())),
        "; ".join(f"{title} {'holds' if good else 'does not hold throughout'}" for title, good in held.items())
        + f"; with four times the load inertia, beyond the claim, the law {'holds' if _is_at_rest(heavy) else 'fails'}",
    )


def _harmonic_balance(numbers: Numbers) -> Section:
    """Beyond the paper: the describing function."""
    sweep, damping = numbers["backlash_sweep"], numbers["damping_sweep"]
    periods = [row["predicted_period_s"] / row["period_s"] for row in sweep]
    predicted = [row["predicted_amplitude_b"] / row["amplitude_b"] for row in sweep]
    mild = [row for row in damping if abs(row["predicted_period_s"] / row["period_s"] - 1) < CLOSE]
    return Section(
        "Harmonic balance (describing function)",
        "harmonic_balance",
        "the describing function predicts the limit cycle",
        "(Slotine & Li, cited by the paper.) A limit cycle can be predicted from the describing function of the gap.",
        f"With the paper's contact law the amplitude is predicted to {_percent(min(predicted), 1)} to {_percent(max(predicted), 1)}, the"
        f" period to {_percent(min(periods), 1)} to {_percent(max(periods), 1)}: the stiff lossy teeth hold the gap at ±d/2 between flights, so it"
        f" is far from the sinusoid that the method assumes. With elastic teeth and damping up to"
        f" {max(row['tooth_damping'] for row in mild):g} N s/m amplitude and period are both within 15 %.",
        _verdict([_all_within(predicted), _all_within(periods)]),
        f"with the paper's contact law the amplitude {'is' if _all_within(predicted) else 'is not'} within 15 %, the period"
        f" {'is' if _all_within(periods) else 'is not'}; both are with elastic teeth damped by up to"
        f" {max(row['tooth_damping'] for row in mild):g} N s/m",
    )


def _friction(numbers: Numbers) -> Section:
    """Beyond the paper: dry friction."""
    friction = numbers["friction_boundary"]
    return Section(
        "Coulomb friction",
        "friction_boundary",
        "dry friction on the load ends the cycle",
        "(Not in the paper.) Friction on the load removes the cycle in real machines.",
        f"With the nominal backlash {1e3 * next(r for r in friction if r['backlash_m'] == 1e-3)['coulomb_friction_Nm']:.0f} mN m are"
        f" enough; {1e3 * min(r['coulomb_friction_Nm'] for r in friction):.0f} to"
        f" {1e3 * max(r['coulomb_friction_Nm'] for r in friction):.0f} mN m over the backlashes tried.",
        _verdict([all(row["coulomb_friction_Nm"] < FRICTION_TRIED for row in friction)]),
    )


_SECTIONS = (
    _open_loop,
    _limit_cycle,
    _share,
    _overdamped,
    _adaptive,
    _linear,
    _noise,
    _robustness,
    _harmonic_balance,
    _friction,
)
