"""Does a reference that moves again in flight cost the law of planned moves anything? Beside moves from rest.

    python benchmarks/moved_in_flight.py --drives 200

The controller knows each drive of `core`: load, friction, delay and gap, but not where its middle is, nor the load
torque. A first step of 1 rad shows it both. Then each flight gives two moves:

- *in flight*: a reference, 0.3 to 1.5 rad away to either side; at a random time of that flight a second one, up to
  1.5 rad from where the load then is, to either side. This move is judged
- *from rest*: 3 s later, a reference as far away as the second one was, and on the same side

Both are judged over 3 s, as docs/evaluation.md says. A second reference that is too near ahead of a moving load is
drawn again: no law could stop there. The load can stop if the motor, after crossing the gap, brakes both inertias with
half its standstill torque.
"""

import argparse
import math
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from backlash_ros.control import Servo
from backlash_ros.control.laws.planned.constants import constants_at
from backlash_ros.control.laws.planned.memory import memory_at
from backlash_ros.control.laws.planned.plan import length_of
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, THETA_L
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation import Member, draw_member
from backlash_ros.studies.evaluation.summary import wilson
from backlash_ros.studies.evaluation.task import first_reading, settings_for, true_reading
from backlash_ros.studies.judging import OVERSHOOT, PRECISE, QUIET, judge_move, threshold

JUDGED = 3.0
"""Length of the record of each move, s."""
NEAREST, FARTHEST = 0.3, 1.5
"""Ways to a reference, rad."""
KINDS, SHARES = ("in flight", "from rest"), ("quiet", "precise", "overshoot ok")


class Played:
    """A drive and the servo that knows it; its moves follow each other."""

    def __init__(self, member: Member) -> None:
        self.member, self.period = member, 1.0 / member.rate
        settings = settings_for(member.drive, member).with_law("planned")
        gap = member.drive.gear.backlash_angle
        self.servo = Servo(member.drive, replace(settings, backlash_angle=gap, identified=True))
        self.plant = SimulatedDrive(member.drive, self.period, sensors=member.sensors, delay=member.delay)
        self.reference, self.force = first_reading(member), 0.0

    def run(self, seconds: float) -> Array:
        """Go on; return what a perfect encoder reads now and after each sample, rad."""
        plant, self.force = self.plant, 0.0
        angles = [float(plant.state[THETA_L])]
        for _ in range(round(seconds / self.period)):
            plant.advance(self.servo.update(plant.sample(), plant.elapsed), self.member.load_torque)
            angles.append(float(plant.state[THETA_L]))
            self.force = max(self.force, plant.peak_force)
        return true_reading(self.member, np.array(angles))

    def send(self, reference: float) -> None:
        """Send a reference, rad."""
        refused = self.servo.set_reference(reference)
        if refused:
            raise RuntimeError(refused)
        self.reference = reference

    def move(self, reference: float) -> dict[str, float]:
        """Send a reference and judge the move to it."""
        self.send(reference)
        position, b, count = self.run(JUDGED), self.member.drive.gear.backlash_angle, self.member.load_count
        move = judge_move(self.period * np.arange(position.size), position, reference, b, count)
        sound = not self.servo.fault
        return {
            "quiet": sound and move.swing <= threshold(QUIET, b, count),
            "precise": sound and move.error <= threshold(PRECISE, b, count),
            "overshoot ok": sound and move.overshoot <= threshold(OVERSHOOT, b, count),
            "overshoot": move.overshoot,
            "settle": move.settle,
            "force": self.force,
        }

    def stops_within(self, speed: float) -> float:
        """Return the way on which the load can stop from a speed, rad."""
        drive, constants = self.member.drive, constants_at(self.servo.law_arrays[0])
        braking = 0.5 * drive.standstill_torque() / drive.effective_inertia
        acts = constants.crossing_time + self.member.delay.mean + self.period
        return float(speed * acts + 0.5 * speed**2 / braking)


def fly(seed: int, flights: int, inertia: float, number: int) -> list[dict[str, Any]]:
    """Return both moves of each flight of a drive; ``inertia`` multiplies that of its load."""
    member = draw_member(seed, number, "core")
    load = replace(member.drive.load, inertia=inertia * member.drive.load.inertia)
    played = Played(replace(member, drive=replace(member.drive, load=load)))
    random, done = np.random.default_rng((seed, number)), []
    played.run(1.0)
    played.move(played.reference + 1.0)
    for _ in range(flights):
        played.send(played.reference + random.choice([-1.0, 1.0]) * random.uniform(NEAREST, FARTHEST))
        played.run(played.period)  # plans the flight
        share = random.uniform()
        at = float(played.run(share * length_of(memory_at(played.servo.law_arrays[1]).plan))[-1])
        speed, way = float(played.plant.state[OMEGA_L]), 0.0
        while 0.0 <= way * math.copysign(1.0, speed) <= played.stops_within(abs(speed)):
            way = random.uniform(-FARTHEST, FARTHEST)
        moves = [played.move(at + way), played.move(played.reference + way)]
        flight = {"drive": number, "share": share, "way": way, "speed": speed, "helped": way * member.load_torque > 0.0}
        done.append({**flight, **dict(zip(KINDS, moves, strict=True))})
    return done


def percent(kind: str, share: str, flights: list[dict[str, Any]]) -> str:
    """Return a share with its 95 % interval."""
    good = sum(each[kind][share] for each in flights)
    low, high = wilson(good, len(flights)) or (np.nan, np.nan)
    return f"{100 * good / len(flights):.1f} ({100 * low:.1f} to {100 * high:.1f})"


def figures(kind: str, name: str, flights: list[dict[str, Any]]) -> str:
    """Return median and 95th percentile."""
    return " / ".join(f"{value:.3g}" for value in np.percentile([each[kind][name] for each in flights], [50, 95]))


def main() -> None:
    """Fly on all cores and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=200)
    parser.add_argument("--flights", type=int, default=5, help="of each drive")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--inertia", type=float, default=1.0, help="factor of each load inertia")
    parser.add_argument("--worst", type=int, default=0, help="how many of the largest overshoots in flight to print")
    given = parser.parse_args()
    job = partial(fly, given.seed, given.flights, given.inertia)
    with ProcessPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        flights = [each for flown in pool.map(job, range(given.drives)) for each in flown]
    print(f"{len(flights)} flights on {given.drives} drives of `core`, seed {given.seed}, J_l x{given.inertia:g}\n")
    print(f"| | {' | '.join(KINDS)} |\n|---|---|---|")
    helped = [each for each in flights if each["helped"]]
    for share in SHARES:
        print(f"| {share}, % | {' | '.join(percent(kind, share, flights) for kind in KINDS)} |")
    words = f"overshoot ok, % of the {len(helped)} to which a load torque pulls"
    if helped:
        print(f"| {words} | {' | '.join(percent(kind, SHARES[-1], helped) for kind in KINDS)} |")
    for name, words in {
        "overshoot": "overshoot, median / 95 %, b",
        "settle": "settled into b/4, median / 95 %, s",
        "force": "largest tooth force, median / 95 %, N",
    }.items():
        print(f"| {words} | {' | '.join(figures(kind, name, flights) for kind in KINDS)} |")
    for each in sorted(flights, key=lambda each: -each[KINDS[0]]["overshoot"])[: given.worst]:
        print(each)


if __name__ == "__main__":
    main()
