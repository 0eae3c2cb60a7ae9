"""What a certificate is about, beside what was found: the recording, the drive as told, and how to repeat it."""

from dataclasses import dataclass, field
from datetime import datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.lost_motion import LostMotion
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding

PACKAGE = "backlash_ros"


@dataclass(frozen=True)
class Subject:
    """Where the numbers come from.

    Attributes
    ----------
    source : the recording's file
    joints : names of the motor's and of the load's
    recording : all that was read; a part of it was fitted
    told : the drive whose motor and gear ratio were taken as they are
    sheet : the file that it was read from; empty for the nominal drive
    command : the command line that makes the certificate again
    counts : of both encoders in a turn of their shafts; 0 where they are not known
    notes : what had to be done to make a recording of the file, in words
    began : when the recording began, where its stamps are dates
    derived : lost motion and stiffness, see `hysteresis_findings` and `lost_motion_of`, and `map_findings`
    rated : torque that the lost motion is given for, N m at the output, and whether it was told
    slow : what a slow torque on an output that stood says, or why there is no such thing in the recording
    """

    source: str
    joints: tuple[str, str]
    recording: Recording
    told: Drive
    sheet: str
    command: str
    counts: tuple[float, float] = (0.0, 0.0)
    notes: tuple[str, ...] = ()
    began: datetime | None = None
    derived: tuple[Finding, ...] = ()
    rated: tuple[float, bool] = (0.0, False)
    slow: LostMotion = field(default_factory=partial(LostMotion, valid=False, reason="it was not looked for"))


def version_of_package() -> str:
    """Return the version of this package; ``unknown`` where it runs without being installed."""
    try:
        return version(PACKAGE)
    except PackageNotFoundError:
        return "unknown"
