"""Compiles every law and every contact once, so that processes that start together find the code: python -m this."""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

import numpy as np

from backlash_ros.control import LAWS, GainSet, Servo, ServoSettings
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Drive, Plant
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.signals import THETA_L, THETA_M, Measurement
from backlash_ros.identification.fitting.fit import compile_filters
from backlash_ros.simulation import Scenario, run


def parts() -> list[Callable[[], None]]:
    """Return what compiles all of it, part by part; neighbours have little in common."""
    gap = NOMINAL_DRIVE.gear.backlash_angle
    settings = ServoSettings(
        GainSet.of(NOMINAL_DRIVE), identified=True, backlash_angle=gap
    )  # what a law needs to act itself
    scenario = Scenario(np.ones(2))
    alone = replace(scenario, sensors=Sensors(measured=("theta_l",)))

    def follow(law: str, scenario: Scenario) -> None:
        angles = {"theta_m": THETA_M, "theta_l": THETA_L}
        seen = [angles[name] for name in scenario.sensors.measured if name in angles]
        at_rest = Measurement(np.where(np.isin(np.arange(5), seen), 0.0, np.nan))
        with suppress(ValueError):  # one from outside that is not made for this drive
            run(NOMINAL_DRIVE, settings.with_law(law), scenario)
            Servo(NOMINAL_DRIVE, settings.with_law(law)).warm_up(at_rest)

    def move(drive: Drive) -> None:
        Plant(drive).advance(0.0, 0.0, settings.period)
        run(drive, settings, scenario)

    plain = [replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=law())) for law in CONTACTS.values()]
    rough = [replace(drive, load=replace(drive.load, coulomb_friction=0.01)) for drive in plain]
    return [
        *(partial(move, drive) for drive in (*plain, *rough)),
        *(partial(follow, law, scenario) for law in LAWS),
        *(partial(follow, law, alone) for law, named in LAWS.items() if named.one_encoder),
        partial(compile_filters, CONTACTS.values()),
    ]


def main() -> None:
    """Run each of them for two samples."""
    for part in parts():
        part()


def _compile(part: int) -> None:
    parts()[part]()


def compile_all() -> None:
    """Compile on all cores what is not compiled yet; the laws themselves are, since they were imported."""
    with ProcessPoolExecutor(mp_context=get_context("fork")) as pool:
        for _ in pool.map(_compile, range(len(parts()))):
            pass


if __name__ == "__main__":
    compile_all()
