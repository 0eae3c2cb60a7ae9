"""An experiment offline: the servo with its experiment and the simulated drive."""

from typing import cast

from backlash_ros.control import BacklashEstimate, Servo, ServoSettings
from backlash_ros.control.experiment import Deferred, Outcome
from backlash_ros.drivetrain import Drive
from backlash_ros.drivetrain.delay import Delay
from backlash_ros.drivetrain.sensors import Sensors
from backlash_ros.foundation.quantity import Validated
from backlash_ros.simulation.simulated_drive import SimulatedDrive


def run_experiment(
    drive: Drive,
    settings: ServoSettings,
    name: str = "",
    parameters: Validated | None = None,
    *,
    model: Drive | None = None,
    load_torque: float = 0.0,
    sensors: Sensors | None = None,
    delay: Delay | None = None,
) -> Outcome:
    """Run one of `EXPERIMENTS` on a simulated drive and return how it ended; `excite` takes one with limits or a seed.

    Parameters
    ----------
    drive, model : the moving drive, and the drive as the controller knows it (the same by default)
    settings : as for the controller node
    name, parameters : of the experiment; by default those of the settings, or its own defaults
    load_torque : constant, on the output shaft, N m
    sensors, delay : between plant and controller

    Raises
    ------
    ValueError
        If there is no such experiment, or the parameters are another's.
    IntegrationError
        If the plant cannot be integrated.
    """
    servo = Servo(model or drive, settings)
    plant = SimulatedDrive(drive, settings.period, sensors=sensors, delay=delay)
    return excite(servo, plant, name, parameters, load_torque=load_torque)


def excite(
    servo: Servo,
    plant: SimulatedDrive,
    name: str = "",
    parameters: Validated | None = None,
    *,
    load_torque: float = 0.0,
) -> Outcome:
    """Run an experiment with a servo on a simulated drive, both in their present state, and return how it ended.

    A servo that holds no position first takes a sample, which shows the encoders.

    Raises
    ------
    ValueError, IntegrationError
        As `run_experiment`.
    """
    if not servo.holding:
        plant.advance(servo.update(plant.sample(), plant.elapsed), load_torque)
    servo.start_experiment(name, parameters)
    while True:
        command = servo.update(plant.sample(), plant.elapsed)
        outcome = servo.take_outcome()
        if outcome is not None:
            return outcome.work() if isinstance(outcome, Deferred) else outcome
        plant.advance(command, load_torque)


def learn_backlash(
    drive: Drive,
    settings: ServoSettings,
    *,
    load_torque: float = 0.0,
    sensors: Sensors | None = None,
    delay: Delay | None = None,
) -> BacklashEstimate:
    """Learn the backlash of a simulated drive by the experiment of the settings; see `run_experiment`.

    Examples
    --------
    >>> from backlash_ros.control import GainSet
    >>> from backlash_ros.drivetrain import NOMINAL_DRIVE
    >>> estimate = learn_backlash(NOMINAL_DRIVE, ServoSettings(GainSet.of(NOMINAL_DRIVE)))
    >>> estimate.valid, round(estimate.angle, 3)
    (True, 0.02)
    """
    outcome = run_experiment(drive, settings, load_torque=load_torque, sensors=sensors, delay=delay)
    return cast("BacklashEstimate", outcome)
