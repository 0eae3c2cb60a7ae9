"""Which numbers of the law and of learning are torques or times, and should be shares of the drive's.

    python benchmarks/scaled.py --drives 6

Each drive of `core` that is sampled at 250 Hz is made weaker and stronger, and faster and slower. All of its torques
are 1/100 or 100 times as large, with the same voltages. Or all of its times are 1/8, 1/2, 2 or 10 times as long, those
of sampling and delay too, with the same torques; 1/8 makes 2 kHz of 250 Hz, the highest rate of a controller. In its
own units of torque and time it is the same drive, and a law of shares does the same with it.

The steps, and how they are judged, are those of docs/evaluation.md, in the times of the drive as it was drawn. The law
for two encoders is told the drive. `parameters`: what a user sets is scaled, too, the times and bandwidths of the law
and of the estimates. `numbers`: so are the tuned numbers of the law that have a time in their unit (`POWERS`). Learning
is `~/identify`; then the law plays with what it found.

With `--each`, each of these numbers alone stays as it is while all others are scaled, and those that change a verdict,
or make a drive settle half as late again, are printed. The first start compiles.
"""

import argparse
import importlib
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tuned_copy import start_in_copy

from backlash_ros.control import ServoSettings
from backlash_ros.control.laws import design_law
from backlash_ros.control.laws.two_encoder import TwoEncoderParameters
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive, IntegrationError
from backlash_ros.drivetrain.contacts.elastic import ElasticContact
from backlash_ros.drivetrain.contacts.power import PowerContact
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.simulation import run
from backlash_ros.studies.evaluation import Member, draw_member
from backlash_ros.studies.evaluation.population import told_model
from backlash_ros.studies.evaluation.task import (
    Learned,
    NotReadyError,
    Task,
    Verdict,
    judge_run,
    prepare,
    scenario_of,
    settings_for,
)

OUT = Path("results/scaled")
LAW, RATE, POPULATION = "two_encoder", 250.0, "core"
VERDICTS = "quiet", "precise", "overshoot_ok"
NEAR = 0.05
"""Share by which a learned gap may be off."""
LATER = 1.5
"""A drive that takes so many times as long to settle is printed by `--each`."""

POWERS = {
    1.0: (
        *("carry._LEAST_RUN", "carry._LONGEST_BRAKE", "carry._LEAST_SHOWING", "crossing._SURE_TIME"),
        *("crossing._FALLEN_TIME", "crossing._LONGEST_RETURN", "crossing._DOUBTED_TIME", "crossing._BEATS_TIME"),
        *("design._PROMPT", "drag._MOMENTUM_NOISE", "drag._MOMENTUM_LAG", "drag._UNEXPLAINED_TIME"),
        *("drag._FADING_TIME", "drag._INERTIA_TIME", "follow._SETTLES", "follow._FIRST_TIME", "hold._AHEAD_TIME"),
        *("load._NOISE_TIME", "load._USUAL_PERIOD", "load_torque._SMOOTHING_TIME", "load_torque._LEAST_TIME"),
        *("load_torque.SETTLE_TIME", "middle._FALL_TIME", "middle._PUSH_TIME", "middle._BEYOND_TIME"),
        *("moves.LEAST_BRAKE", "parking.DWELL", "parking._WATCH_TIME", "parking._WATCH_GROWTH"),
        *("parking._REST_TIME", "parking._PARK_TIME", "throw._SHORT_BRAKE"),
    ),
    0.5: ("drag._TORQUE_NOISE",),
    -0.5: ("drag._WALK",),
    -1.0: (
        *("command._FRICTION_RATE", "drag._LEAST_SPEED", "drag._LOAD_SPEED", "follow._SEAT_RATE", "hold._SHIFT_SPEED"),
        *("hold._HELD_RATE", "hold.FREE_RATE", "hold.MEET_RATE", "load.STANDSTILL", "load_torque._TURNING_SPEED"),
        *("load_torque._LAG_RATE", "middle._FALL_SPEED", "motor._FULL_FRICTION_SPEED", "motor.REST_SPEED"),
        *("motor.STUCK_SPEED", "moves.CARRY_SPEED", "parking.LARGEST_LEAD", "reference.CREEPS", "start._BLOW_RATE"),
    ),
    -2.0: (
        *("design._ACCELERATION_NOISE", "design._LEAST_EXCESS", "design._MOST_EXCESS", "design._FIRST_TORQUE"),
        *("follow._PUSHES", "load._FLIGHT_UNCERTAINTY", "load._HOLD_UNCERTAINTY", "load._FREE_UNCERTAINTY"),
        *("load_torque.LEAST_SHOWN", "load_torque._UNSURE", "middle._LEAST_TORQUE", "middle._UNKNOWN_TORQUE"),
        *("motor._STICKING_FRICTION", "moves._TOUCH_TORQUE", "plan._LEAST_STEP", "throw._HARD"),
    ),
    -2.5: ("design._TORQUE_NOISE",),
}
"""The tuned numbers of the law that have a time in their unit, by its power; a noise has the root of one."""
POWER_OF = {name: power for power, names in POWERS.items() for name in names}


class Scale(NamedTuple):
    """Factors of all torques and of all times; whether the parameters of the law, and its numbers, are scaled, too."""

    torque: float = 1.0
    time: float = 1.0
    parameters: bool = False
    numbers: bool = False

    def __str__(self) -> str:
        factors = [f"{name} x {x:g}" for name, x in (("torques", self.torque), ("times", self.time)) if x != 1.0]
        more = [name for name in ("parameters", "numbers") if getattr(self, name)]
        return ", ".join([*factors, *more]) or "as drawn"

    def drive(self, drive: Drive) -> Drive:
        """Return a drive that the same voltages move the same way, in other units of torque and time."""
        torque, time = self.torque, self.time
        motor, load, contact = drive.motor, drive.load, drive.gear.contact
        if isinstance(contact, PowerContact):
            damping = contact.damping * torque * time
            contact = replace(contact, stiffness=contact.stiffness * torque, damping=damping)
        elif isinstance(contact, ElasticContact):
            damping = contact.damping * torque * time
            contact = replace(contact, wind_up=contact.wind_up / torque, damping=damping)
        return Drive(
            replace(
                motor,
                resistance=motor.resistance * time / torque,
                inductance=motor.inductance * time**2 / torque,
                torque_constant=motor.torque_constant * time,
                inertia=motor.inertia * torque * time**2,
                viscous_friction=motor.viscous_friction * torque * time,
            ),
            replace(drive.gear, contact=contact),
            replace(
                load,
                inertia=load.inertia * torque * time**2,
                viscous_friction=load.viscous_friction * torque * time,
                coulomb_friction=load.coulomb_friction * torque,
            ),
        )

    def member(self, drawn: Member) -> Member:
        """Return a drive of the population with its surroundings."""
        return replace(
            drawn,
            drive=self.drive(drawn.drive),
            delay=Delay(command=drawn.delay.command * self.time),
            rate=drawn.rate / self.time,
            load_torque=drawn.load_torque * self.torque,
            torque_change=drawn.torque_change * self.torque,
        )

    def settings(self, settings: ServoSettings) -> ServoSettings:
        """Return the settings of a controller with `LAW`."""
        if not self.parameters:
            return settings.with_law(LAW)
        given = asdict(TwoEncoderParameters())
        own = {name: each * self.time ** (1 if name.endswith("_time") else -1) for name, each in given.items()}
        bandwidths = {name: getattr(settings, name) / self.time for name in ("velocity_bandwidth", "torque_bandwidth")}
        return replace(settings, **bandwidths).with_law(LAW, TwoEncoderParameters(**own))


SCALES = (
    Scale(),
    *(Scale(torque=factor) for factor in (0.01, 100.0)),
    *(Scale(time=t) for t in (0.125, 0.5, 2.0, 10.0)),
)
FARTHEST = Scale(time=0.125), Scale(time=10.0)
WITH_PARAMETERS = [each._replace(parameters=True) for each in FARTHEST]
WITH_NUMBERS = [each._replace(numbers=True) for each in WITH_PARAMETERS]


def use_numbers(scale: Scale, *left: str) -> None:
    """Let the law in the copy use its numbers as scaled, but for those that are ``left``."""
    tuned: Any = importlib.import_module(f"backlash_ros.control.laws.{LAW}.tuned")
    time = scale.time if scale.numbers else 1.0
    values = [value * time ** (0.0 if name in left else POWER_OF.get(name, 0.0)) for name, value in tuned.BASE.items()]
    tuned.VALUES_AND_READ[: tuned.SIZE] = values
    design_law.cache_clear()


def play(drawn: Member, scale: Scale, settings: ServoSettings, known: Drive) -> Verdict:
    """Return the verdict on the drive as scaled, in the times of the drive as drawn."""
    member, scenario = scale.member(drawn), scenario_of(drawn)
    scaled = replace(scenario, load_torque=scenario.load_torque * scale.torque, delay=member.delay)
    try:
        done = run(member.drive, scale.settings(settings), scaled, model=known)
    except (ValueError, IntegrationError) as error:
        return Verdict(failure=str(error))
    return judge_run(drawn, scenario, replace(done, time=done.time / scale.time))


def play_told(drawn: Member, scale: Scale) -> Verdict:
    """Play with a controller that is told the drive."""
    member = scale.member(drawn)
    known = told_model(member, "true", scale.drive(NOMINAL_DRIVE))
    settings = settings_for(known, member)
    gap = member.drive.gear.backlash_angle
    return play(drawn, scale, replace(settings, identified=True, backlash_angle=gap), known)


def learn(drawn: Member, scale: Scale) -> tuple[Learned, Verdict]:
    """Identify the drive, and play with what was found."""
    task = Task(0, POPULATION, "identified", around=scale.drive(NOMINAL_DRIVE))
    try:
        ready = prepare(task, scale.member(drawn))
    except NotReadyError as error:
        return error.learned, Verdict(failure=str(error))
    return ready.learned, play(drawn, scale, ready.settings, ready.known)


def passed(verdicts: Iterable[Verdict]) -> str:
    """Return how many drives pass each verdict, and how long they take to settle, s."""
    every = list(verdicts)
    settle = [each.step.settle for each in every]
    counts = " / ".join(f"{sum(getattr(each, name) for each in every)}" for name in VERDICTS)
    return f"{counts} | {np.median(settle):.2f} / {max(settle):.2f}"


def learned(found: list[Learned]) -> str:
    """Return how many drives were learned, and how well."""
    near = sum(each.valid and abs(each.angle / each.gap - 1.0) <= NEAR for each in found)
    ratio, identified = sum(each.ratio_close for each in found), sum(each.identified for each in found)
    return f"{sum(each.valid for each in found)} / {near} / {ratio} / {identified}"


def table(titles: str, scales: Iterable[Scale], row: Callable[[Scale], str]) -> None:
    """Print a table with a row for each scale."""
    print(f"\n| {titles} |\n|---{'|---:' * titles.count('|')}|")
    for scale in scales:
        use_numbers(scale)
        print(f"| {scale} | {row(scale)} |", flush=True)


def leave_each(members: list[Member], scale: Scale) -> None:
    """Print the numbers of which one alone, not scaled, changes what the law does."""
    use_numbers(scale)
    base = [play_told(member, scale) for member in members]
    for name in POWER_OF:
        use_numbers(scale, name)
        pairs = list(zip(base, [play_told(member, scale) for member in members], strict=True))
        turned = [getattr(new, each) - getattr(old, each) for old, new in pairs for each in VERDICTS]
        late = sum(new.step.settle > LATER * old.step.settle for old, new in pairs)
        if any(turned) or late:
            lost, won = turned.count(-1), turned.count(1)
            print(f"{scale}, without {name}: lost {lost}, won {won}, late {late}", flush=True)


def main() -> None:
    """Start in the copy, play all drives at each scale, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=6)
    parser.add_argument("--seed", type=int, default=918273)
    parser.add_argument("--each", action="store_true", help="look at each number alone, and do not learn")
    given = parser.parse_args()
    start_in_copy(OUT)
    drawn = (draw_member(given.seed, number, POPULATION) for number in range(100 * given.drives))
    members = [member for member in drawn if member.rate == RATE][: given.drives]
    judged = "quiet / precise / overshoot ok | settled, median / slowest, s"
    table(
        f"told | {judged}",
        (*SCALES, *WITH_PARAMETERS, *WITH_NUMBERS),
        lambda scale: passed(play_told(each, scale) for each in members),
    )
    if given.each:
        for scale in WITH_NUMBERS:
            leave_each(members, scale)
        return

    def row(scale: Scale) -> str:
        found, verdicts = zip(*(learn(each, scale) for each in members), strict=True)
        return f"{learned(list(found))} | {passed(verdicts)}"

    table(f"learned | valid / gap close / inertia close / identified | {judged}", SCALES, row)


if __name__ == "__main__":
    main()
