"""What the MuJoCo export does beside our simulator: commands recorded here, played there.

Run as a program it prints the table of docs/simulators.md. Angles are compared as at the output, from the same state on
and over the whole recording: nothing brings the two together again.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from backlash_ros.control import GainSet, Servo, ServoSettings
from backlash_ros.control.experiment import BacklashEstimate, Deferred
from backlash_ros.drive_file.drive_file import Axis
from backlash_ros.drivetrain import NOMINAL_DRIVE, Drive
from backlash_ros.drivetrain.sensors import POSITIONS, Sensors
from backlash_ros.export import mjcf
from backlash_ros.foundation.record import Array
from backlash_ros.foundation.signals import OMEGA_L, OMEGA_M, THETA_L, THETA_M
from backlash_ros.identification.drive import identified_drive
from backlash_ros.simulation import SimulatedDrive
from backlash_ros.studies.evaluation.population import draw_member

COUNTS = 65536.0
"""Of both encoders, a turn."""


@dataclass(frozen=True)
class Recording:
    """Commands (V or A), each held for a period (s), and what became of them: angles of motor and load at the output.

    ``start`` is the state before: theta_m, omega_m, theta_l, omega_l, current.
    """

    period: float
    command: Array
    motor: Array
    load: Array
    start: Array


def random_commands(drive: Drive, period: float, seconds: float, seed: int) -> Array:
    """Return random commands, each for 20 to 200 ms: at most half the voltage, a tenth of the current."""
    random = np.random.default_rng(seed)
    most = drive.command_limit * (0.1 if drive.takes_current else 0.5)
    out: list[float] = []
    while len(out) < seconds / period:
        out += [random.uniform(-most, most)] * max(1, int(random.uniform(0.02, 0.2) / period))
    return np.array(out[: int(seconds / period)])


def play_here(drive: Drive, command: Array, period: float, start: Array | None = None) -> Recording:
    """Play commands on our simulator, from rest in the middle of the gap by default."""
    plant = SimulatedDrive(drive, period)
    begin = np.zeros(5) if start is None else start
    plant.state[:5] = begin
    rows = [plant.state[:5].copy()]
    for value in command:
        plant.advance(value)
        rows.append(plant.state[:5].copy())
    seen = np.array(rows)
    return Recording(period, command, drive.gear.ratio * seen[:, THETA_M], seen[:, THETA_L], begin)


def play_there(drive: Drive, recording: Recording, text: str = "") -> Recording:
    """Play the commands of a recording on the MuJoCo export of a drive."""
    model = mujoco.MjModel.from_xml_string(text or mjcf(Axis(drive)))
    data = mujoco.MjData(model)
    steps = round(recording.period / model.opt.timestep)
    assert abs(steps * model.opt.timestep - recording.period) < 1e-9
    start = recording.start
    data.qpos[:] = start[[THETA_M, THETA_L]]
    data.qvel[:] = start[[OMEGA_M, OMEGA_L]]
    if model.na:
        data.act[:] = start[4]
    rows = [data.qpos.copy()]
    for value in recording.command:
        data.ctrl[0] = value
        mujoco.mj_step(model, data, steps)
        rows.append(data.qpos.copy())
    seen = np.array(rows)
    return replace(recording, motor=drive.gear.ratio * seen[:, 0], load=seen[:, 1])


def errors(here: Recording, there: Recording) -> tuple[float, float]:
    """Return the rms of the difference, of motor and load, over the rms of the motion about its mean."""
    pairs = (here.motor, there.motor), (here.load, there.load)
    a, b = (float(np.sqrt(np.mean((x - y) ** 2)) / np.std(x)) for x, y in pairs)
    return a, b


def settings_of(drive: Drive, period: float) -> ServoSettings:
    return ServoSettings(GainSet.of(drive), backlash_angle=drive.gear.backlash_angle, period=period)


class _Recorder:
    """A servo on a simulated drive, all of which is kept."""

    def __init__(self, drive: Drive, model: Drive, period: float) -> None:
        sensors = Sensors(measured=POSITIONS, motor_counts=COUNTS, load_counts=COUNTS)
        self.servo = Servo(model, settings_of(model, period))
        self.plant = SimulatedDrive(drive, period, sensors=sensors)
        self.period = period
        self.commands: list[float] = []
        self.states = [self.plant.state[:5].copy()]

    def tick(self) -> None:
        """Take a sample and answer it."""
        self.advance(self.servo.update(self.plant.sample(), self.plant.elapsed))

    def advance(self, command: float) -> None:
        """Apply a command."""
        self.plant.advance(command)
        self.commands.append(command)
        self.states.append(self.plant.state[:5].copy())

    def recording(self) -> Recording:
        """Return what was kept."""
        seen, n = np.array(self.states), self.plant.drive.gear.ratio
        return Recording(self.period, np.array(self.commands), n * seen[:, THETA_M], seen[:, THETA_L], np.zeros(5))


def record_steps(drive: Drive, period: float, seed: int) -> Recording:
    """Record eight steps, each 0.25 s long, of 1 to 20 times the gap to either side, under the default law."""
    random, made = np.random.default_rng(seed), _Recorder(drive, drive, period)
    made.tick()
    for side in (1, -1) * 4:
        made.servo.set_reference(side * drive.gear.backlash_angle * random.uniform(0.5, 10.0))
        for _ in range(int(0.25 / period)):
            made.tick()
    return made.recording()


def record_probe(drive: Drive, told: Drive, period: float) -> tuple[Recording, Drive | None]:
    """Record the probe of the gap, and return it with the drive that was identified from it, if it was."""
    made = _Recorder(drive, told, period)
    made.tick()
    made.servo.start_experiment("gap_probe")
    while True:
        command = made.servo.update(made.plant.sample(), made.plant.elapsed)
        outcome = made.servo.take_outcome()
        if outcome is not None:
            break
        made.advance(command)
    outcome = outcome.work() if isinstance(outcome, Deferred) else outcome
    if not (isinstance(outcome, BacklashEstimate) and outcome.valid and outcome.fit is not None):
        return made.recording(), None
    return made.recording(), identified_drive(told, outcome.fit)


def members(number: int, interface: str, population: str = "core", seed: int = 20090) -> Iterator[tuple[Drive, float]]:
    """Yield the first drives of a population with their periods."""
    for k in range(number):
        member = draw_member(seed, k, population)
        yield replace(member.drive, command_interface=interface), 1.0 / member.rate


def with_mean_gap(drive: Drive) -> Drive:
    """Return the drive with a gap that is the same all around."""
    return replace(drive, gear=replace(drive.gear, backlash_variation=0.0))


def told_of(drive: Drive) -> Drive:
    """Return what the controller is told at first: the data sheet, an upper guess of the gap, the nominal load."""
    gear = replace(NOMINAL_DRIVE.gear, reduction=drive.gear.reduction, backlash_angle=0.1)
    return replace(drive, gear=gear, load=NOMINAL_DRIVE.load)


Pairs = list[tuple[float, float]]


def tell(name: str, rows: Pairs) -> None:
    """Print a row of the table."""
    worse = 100.0 * np.max(rows, axis=1)
    within = f"{np.sum(worse <= 10.0)} of {len(rows)}"
    print(f"| {name} | {within} | {np.median(worse):.2g} | {np.max(worse):.2g} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--drives", type=int, default=10)
    number = parser.parse_args().drives
    for interface in ("voltage", "current"):
        for words, population, change in (
            ("`core`", "core", with_mean_gap),
            ("`full`, constant gap", "full", with_mean_gap),
            ("`full`", "full", lambda drive: drive),
        ):
            random_errors: Pairs = []
            step_errors: Pairs = []
            for seed, (drawn, period) in enumerate(members(number, interface, population)):
                drive = change(drawn)
                random = play_here(drive, random_commands(drive, period, 2.0, seed), period)
                random_errors.append(errors(random, play_there(drive, random)))
                steps = record_steps(drive, period, seed)
                step_errors.append(errors(steps, play_there(drive, steps)))
            tell(f"random commands, {interface} | {words}", random_errors)
            tell(f"steps, {interface} | {words}", step_errors)
        there: Pairs = []
        here: Pairs = []
        for drive, period in members(number, interface):
            probe, found = record_probe(drive, told_of(drive), period)
            if found is not None:
                there.append(errors(probe, play_there(found, probe)))
                here.append(errors(probe, play_here(found, probe.command, period)))
        tell(f"probe, {interface} | `core`, as identified from it", there)
        tell(f"probe, {interface} | the same drives in our simulator", here)


if __name__ == "__main__":
    main()
