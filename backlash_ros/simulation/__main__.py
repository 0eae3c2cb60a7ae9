"""Compiles every law and every contact once, so that processes that start together find the code: python -m this."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from backlash_ros.control import DEFAULT_WEIGHTS, LAWS, GainSet, ServoSettings, design_gains
from backlash_ros.drivetrain import CONTACTS, NOMINAL_DRIVE, Plant
from backlash_ros.identification.fit import compile_filters
from backlash_ros.simulation import Scenario, run


def main() -> None:
    """Run each of them for two samples."""
    gains = {region: design_gains(region, NOMINAL_DRIVE, weights) for region, weights in DEFAULT_WEIGHTS.items()}
    settings, scenario = ServoSettings(GainSet(**gains)), Scenario(np.ones(2))
    for law in LAWS:
        with suppress(ValueError):  # one from outside that is not made for this drive
            run(NOMINAL_DRIVE, settings.with_law(law), scenario)
    for contact in CONTACTS.values():
        plain = replace(NOMINAL_DRIVE, gear=replace(NOMINAL_DRIVE.gear, contact=contact()))
        for drive in (plain, replace(plain, load=replace(plain.load, coulomb_friction=0.01))):
            run(drive, settings, scenario)
            Plant(drive).advance(0.0, 0.0, settings.period)
    compile_filters(CONTACTS.values())


if __name__ == "__main__":
    main()
