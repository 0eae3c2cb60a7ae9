"""The findings of a fit: each quantity with its standard uncertainty, or why the recording does not show it."""

import math
from dataclasses import dataclass, replace

from backlash_ros.drivetrain import Drive
from backlash_ros.foundation.record import Array
from backlash_ros.identification.fitting.fit import Fit
from backlash_ros.identification.fitting.parameters import Parameters, parameters_of, place_of
from backlash_ros.identification.gap import Gap

NOISE = 2.0
"""Component of an uncertainty: a factor on the standard deviation from the noise; tuned."""
MODEL = 0.005
"""Component of an uncertainty: a share of the value; tuned."""
LEAST = 1e-4
"""Component of a torque's uncertainty: a share of the standstill torque; tuned."""
LEAST_DELAY = 0.005
"""Component of the delay's uncertainty: a share of the period; tuned."""
UNEXPLAINED = 20.0
"""Component of the inertia's uncertainty: a share, times the load's unexplained torque over the standstill torque.

A load that is not rigid, or that something else moves, shows as such a torque."""
OF_MOTOR = 10.0
"""Component of the inertia's uncertainty: a share, times the motor's unexplained torque over the standstill torque."""
OF_TEETH = 1.0
"""Component of the inertia's uncertainty: a share, times the unexplained share of the teeth's torque."""
MOST_LOSS = 0.5
"""Largest loss of the gear with which the load's inertia is told: a worm passes on less of it than of the torque."""
UNSEEN = 3.0
"""Factor on all other uncertainties if the gap is unknown: unknown teeth bias everything that acts through them."""
SURE_INERTIA = 0.05
"""Largest standard uncertainty of the inertia, a share of it; tuned."""
SURE_FRICTION = 0.25
"""Largest standard uncertainty of a friction, a share of it, where it exceeds `SMALL`; tuned."""
SURE_RESISTANCE = 0.1
"""Largest standard uncertainty of the load's total friction, a share of it, where it exceeds `SMALL`; tuned."""
SURE_TORQUE = 0.1
"""Largest standard uncertainty of the load torque and its slope, a share, where it exceeds `SMALL`; tuned."""
SMALL = 1e-3
"""Torque that hardly matters, as a share of the standstill torque."""
SURE_DELAY = 0.25
"""Largest standard uncertainty of the delay, in periods; tuned."""
SURE_SLOPE = 0.1
"""Largest standard uncertainty of what the gap changes by, in gaps for each rad; tuned."""
SURE_TEETH = 0.2
"""Largest standard uncertainty of the teeth's stiffness, a share of it; tuned."""
SURE_SCALE = 2.5e-3
"""Largest standard uncertainty of the share by which the load's encoder reads too much; tuned."""
SURE_MOTOR = 0.05
"""Largest standard uncertainty of the motor's constant and resistance, shares of them; tuned."""
SURE_LOSS = 0.05
"""Largest standard uncertainty of the gear's loss, itself a share; tuned."""
_CONSTANT = {"ln_motor_braking": 1.0, "ln_motor_gain": -1.0}
"""K_m by the gain K/R and the braking K^2/R, as powers."""
_RESISTANCE = {"ln_motor_braking": 1.0, "ln_motor_gain": -2.0}
"""R by the gain K/R and the braking K^2/R, as powers."""
ROUGH_INERTIA = 10.0
"""Factor on the bound of the inertia up to which it is good enough to plan moves, though it is not told; tuned."""
ROUGH_FRICTION = 5.0
"""Factor on the bounds of friction up to which it is good enough to plan moves, though it is not told; tuned."""
SPEEDS = 1.0, 10.0
"""Speed of the load, rad/s, at which its total friction is given, viscous and dry."""


@dataclass(frozen=True)
class Finding:
    """One quantity: ``value`` and standard ``uncertainty`` in ``unit``; both are nan if unknown, and ``why`` says why.

    ``key`` is its name in a drive file; empty if it has none. ``rough``: the value is too uncertain to be told, as
    ``why`` says, but good enough to plan moves.
    """

    key: str
    symbol: str
    what: str
    unit: str
    value: float = math.nan
    uncertainty: float = math.nan
    why: str = ""
    rough: bool = False

    @property
    def told(self) -> bool:
        """Whether there is a value that is sure."""
        return not self.why

    @property
    def plans(self) -> bool:
        """Whether there is a value with which moves can be planned."""
        return self.told or self.rough


@dataclass(frozen=True)
class _Rules:
    """A fit, and the bounds for its findings; ``valid``: whether the gap is known."""

    drive: Drive
    found: Fit
    x: Parameters
    covariance: Array
    period: float
    stall: float
    valid: bool

    def deviation(self, name: str) -> float:
        """Return the standard uncertainty of a parameter, in its unit."""
        least = {"delay": LEAST_DELAY * self.period}
        least |= dict.fromkeys(("load_coulomb", "motor_coulomb", "load_torque"), LEAST * self.stall)
        place = place_of(name)
        deviation = NOISE * math.sqrt(max(float(self.covariance[place, place]), 0.0))
        return math.hypot(deviation, least.get(name, 0.0))

    def decide(
        self,
        row: Finding,
        value: float,
        deviation: float,
        bound: float,
        hint: str = "",
        model: float = MODEL,
        rough: float = 0.0,
    ) -> Finding:
        """Return a row with its value if its ``deviation`` plus the ``model``'s share are within a ``bound``.

        ``rough``: factor on the bound within which the value is good enough to plan moves, if the gap is known.
        """
        uncertainty = math.hypot(deviation, model * value)
        known = replace(row, value=value, uncertainty=uncertainty)
        if uncertainty <= bound:
            return known
        why = f"its standard uncertainty is {uncertainty:.2g} {row.unit}, more than {bound:.2g}{hint}"
        if self.valid and uncertainty <= rough * bound:
            return replace(known, why=why, rough=True)
        return replace(row, why=why)

    def resistance(self, speed: float) -> tuple[float, float]:
        """Return the load's friction at a speed, viscous and dry, and its deviation, N m."""
        viscous = math.exp(self.x.ln_load_viscous) * speed
        cov, v, c = self.covariance, place_of("ln_load_viscous"), place_of("load_coulomb")
        variance = viscous**2 * cov[v, v] + cov[c, c] + 2.0 * viscous * cov[v, c]
        deviation = NOISE * math.sqrt(max(float(variance), 0.0))
        return viscous + float(self.x.load_coulomb), math.hypot(deviation, LEAST * self.stall)

    def _unexplained(self) -> str:
        """Return what to say of an inertia that is uncertain because something else moves the load."""
        share, loss = self.found.noise[1], self.x.gear_loss
        if loss > MOST_LOSS:
            return f": the gear loses {100.0 * loss:.0f} % of the torque, and what the motor feels of the load differs"
        if UNEXPLAINED * share < SURE_INERTIA:
            return ""
        return (
            f": {100.0 * share:.2g} % of the standstill torque on the load is unexplained, as if it were not rigid, or "
            "something else moved it"
        )

    def load(self) -> list[Finding]:
        x, small, (motor, load, teeth) = self.x, SMALL * self.stall, self.found.noise[:3]
        lost = math.inf if x.gear_loss > MOST_LOSS else 0.0
        inertia, viscous, dry = math.exp(x.ln_load_inertia), math.exp(x.ln_load_viscous), float(x.load_coulomb)
        own = self.deviation("ln_load_inertia")
        deviation = math.hypot(own, UNEXPLAINED * load, OF_MOTOR * motor, OF_TEETH * teeth, lost)
        both = [
            self.decide(
                Finding("", f"{speed:g} B_l + c_l", f"the load's friction at {speed:g} rad/s", "N m"),
                *(at := self.resistance(speed)),
                max(SURE_RESISTANCE * at[0], small),
                rough=ROUGH_FRICTION,
            )
            for speed in SPEEDS
        ]
        hint = "; viscous and dry friction cannot be separated well, see their sum" if any(r.told for r in both) else ""
        return [
            self.decide(
                Finding("load.inertia", "J_l", "the load's inertia", "kg m^2"),
                inertia,
                deviation * inertia,
                SURE_INERTIA * inertia,
                self._unexplained(),
                rough=ROUGH_INERTIA,
            ),
            self.decide(
                Finding("load.viscous_friction", "B_l", "the load's viscous friction", "N m s/rad"),
                viscous,
                self.deviation("ln_load_viscous") * viscous,
                SURE_FRICTION * viscous,
                hint,
            ),
            self.decide(
                Finding("load.coulomb_friction", "c_l", "the load's dry friction", "N m"),
                dry,
                self.deviation("load_coulomb"),
                max(SURE_FRICTION * dry, small),
                hint,
            ),
            *both,
        ]

    def around(self) -> list[Finding]:
        """Return the external torques on both shafts, and the delay."""
        x, ratio, small = self.x, self.drive.gear.ratio, SMALL * self.stall
        dry, torque, slope = float(x.motor_coulomb), float(x.load_torque), float(x.load_torque_slope)
        return [
            self.decide(
                Finding("motor.coulomb_friction", "c_m", "the motor's dry friction, before the gear", "N m"),
                dry * ratio,
                self.deviation("motor_coulomb") * ratio,
                max(SURE_FRICTION * dry, small) * ratio,
            ),
            self.decide(
                Finding("expected_load_torque", "tau_l", "load torque and weight at the load's start position", "N m"),
                torque,
                self.deviation("load_torque"),
                max(SURE_TORQUE * abs(torque), 2.0 * small),
            ),
            self.decide(
                Finding(
                    "expected_load_torque_slope",
                    "dtau_l/dtheta_l",
                    "growth of that torque with the load's angle (weight)",
                    "N m/rad",
                ),
                slope,
                self.deviation("load_torque_slope"),
                max(SURE_TORQUE * abs(slope), 10.0 * small),
            ),
            self.decide(
                Finding("delay.command", "delay", "time from a sample to when its command acts", "s"),
                float(x.delay),
                self.deviation("delay"),
                SURE_DELAY * self.period,
            ),
        ]

    def motor(self) -> list[Finding]:
        """Return what the data sheet says of motor and gear, as found: the rotor's inertia sets the unit of torque."""
        motor = self.drive.motor
        constant, resistance = ({"ln_motor_gain": 1.0}, {}) if self.drive.takes_current else (_CONSTANT, _RESISTANCE)
        rows = [
            self._of_logarithms(
                Finding("motor.torque_constant", "K_m", "the motor's torque constant, by its inertia", "N m/A"),
                motor.torque_constant,
                constant,
            ),
            self._of_logarithms(
                Finding("motor.resistance", "R", "the motor's resistance, by its inertia", "ohm"),
                motor.resistance,
                resistance,
            ),
        ]
        rows = rows[:1] if self.drive.takes_current else rows
        loss = Finding("", "loss", "loss of the gear, a share of the teeth's torque", "")
        return [*rows, self.decide(loss, float(self.x.gear_loss), self.deviation("gear_loss"), SURE_LOSS)]

    def _of_logarithms(self, row: Finding, told: float, powers: dict[str, float]) -> Finding:
        """Return the row of a ``told`` value times the exponential of parameters with factors."""
        factors = parameters_of(**powers)
        value = told * math.exp(float(factors @ self.found.parameters))
        deviation = NOISE * math.sqrt(max(float(factors @ self.covariance @ factors), 0.0))
        return self.decide(row, value, deviation * value, SURE_MOTOR * value)

    def encoder(self) -> Finding:
        """Return the relative scale error of the load's encoder at its position, an effect of eccentricity."""
        row = Finding("", "eccentricity", "relative scale error of the load's encoder here", "")
        return self.decide(row, float(self.x.load_scale_error), self.deviation("load_scale_error"), SURE_SCALE)

    def teeth(self) -> list[Finding]:
        """Return the other properties of the gap if both flanks were seen."""
        x = self.x
        rows = [
            self.decide(
                Finding("sensors.load_offset", "offset", "reading of the load's encoder at the motor's zero", "rad"),
                -float(x.offset),
                self.deviation("offset"),
                math.inf,
                model=0.0,
            ),
            self.decide(
                Finding("", "(db/dtheta_l)/b", "relative growth of the gap with the load's angle", "1/rad"),
                float(x.gap_slope),
                self.deviation("gap_slope"),
                SURE_SLOPE,
            ),
        ]
        if self.found.teeth.free:
            give, deviation = self.found.wind_up()
            what = f"wind-up of the teeth at the output, up to {self.found.bearing:.2g} N m"
            row = Finding("contact.elastic.wind_up", "wind-up", what, "rad/(N m)")
            rows.append(self.decide(row, give, NOISE * deviation, SURE_TEETH * give))
        return rows


def findings_of(drive: Drive, gap: Gap, found: Fit, period: float) -> list[Finding]:
    """Return all findings of a fit, in a fixed order: load, external torques, gap, motor, encoders.

    Parameters
    ----------
    drive : as told
    gap : with its verdict; the teeth are told only where it is valid
    period : of the samples, s
    """
    covariance = found.covariance * (1.0 if gap.valid else UNSEEN**2)
    rules = _Rules(drive, found, found.values, covariance, period, drive.standstill_torque(), gap.valid)
    teeth = rules.teeth()
    width = Finding("gear.backlash_angle", "b", "the gap at the load's start position", "rad")
    if gap.valid:
        width = Finding(width.key, width.symbol, width.what, width.unit, gap.angle, gap.uncertainty)
    else:
        width, *teeth = (Finding(r.key, r.symbol, r.what, r.unit, why=gap.reason) for r in (width, *teeth))
    return [width, *rules.load(), *rules.around(), *teeth, *rules.motor(), rules.encoder()]
