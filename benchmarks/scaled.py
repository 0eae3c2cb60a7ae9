"""Whether the law and learning do the same with weak and strong, slow and fast drives.

    python benchmarks/scaled.py --drives 6

Each drive of `core` that is sampled at 250 Hz is made weaker and stronger, and faster and slower. All of its torques
are 1/100 or 100 times as large, with the same voltages. Or all of its times are 1/8, 1/2, 2 or 10 times as long, those
of sampling and delay too, with the same torques; 1/8 makes 2 kHz of 250 Hz, the highest rate of a controller. In its
own units of torque and time it is the same drive, and a law of shares does the same with it.

The steps, and how they are judged, are those of docs/evaluation.md, in the times of the drive as it was drawn. The law
of planned moves is told the drive. Learning is `~/identify`; then the law plays with what it found.
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from backlash_ros.control import ServoSettings
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

LAW, RATE, POPULATION = "planned", 250.0, "core"
VERDICTS = "quiet", "precise", "overshoot_ok"
NEAR = 0.05
"""Share by which a learned gap may be off."""


class Scale(NamedTuple):
    """Factors of all torques and of all times."""

    torque: float = 1.0
    time: float = 1.0

    def __str__(self) -> str:
        factors = [f"{name} x {x:g}" for name, x in (("torques", self.torque), ("times", self.time)) if x != 1.0]
        return ", ".join(factors) or "as drawn"

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


SCALES = (
    Scale(),
    *(Scale(torque=factor) for factor in (0.01, 100.0)),
    *(Scale(time=t) for t in (0.125, 0.5, 2.0, 10.0)),
)


def play(drawn: Member, scale: Scale, settings: ServoSettings, known: Drive) -> Verdict:
    """Return the verdict on the drive as scaled, in the times of the drive as drawn."""
    member, scenario = scale.member(drawn), scenario_of(drawn)
    scaled = replace(scenario, load_torque=scenario.load_torque * scale.torque, delay=member.delay)
    try:
        done = run(member.drive, settings.with_law(LAW), scaled, model=known)
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
        print(f"| {scale} | {row(scale)} |", flush=True)


def main() -> None:
    """Play all drives at each scale, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=6)
    parser.add_argument("--seed", type=int, default=918273)
    given = parser.parse_args()
    drawn = (draw_member(given.seed, number, POPULATION) for number in range(100 * given.drives))
    members = [member for member in drawn if member.rate == RATE][: given.drives]
    judged = "quiet / precise / overshoot ok | settled, median / slowest, s"
    table(f"told | {judged}", SCALES, lambda scale: passed(play_told(each, scale) for each in members))

    def row(scale: Scale) -> str:
        found, verdicts = zip(*(learn(each, scale) for each in members), strict=True)
        return f"{learned(list(found))} | {passed(verdicts)}"

    table(f"learned | valid / gap close / inertia close / identified | {judged}", SCALES, row)


if __name__ == "__main__":
    main()
