"""The subject of a certificate: the recording, the drive as described, and how to repeat it."""

from dataclasses import dataclass, field
from datetime import datetime
from functools import partial

from backlash_ros.drivetrain import Drive
from backlash_ros.identification.locked_output.lost_motion import LostMotion
from backlash_ros.identification.recording import Recording
from backlash_ros.identification.recordings.findings import Finding


@dataclass(frozen=True)
class Subject:
    """Where the numbers come from.

    Attributes
    ----------
    source : the recording's file
    joints : names of the motor's and of the load's
    recording : all that was read; a part of it was fitted
    told : the described drive, whose motor and gear ratio were taken as given
    sheet : what described it: a file, or the bag's controller; empty for the nominal drive
    command : the command line that makes the certificate again
    counts : of both encoders per turn of their shafts; 0 if unknown
    notes : how the file was turned into a recording, in words
    began : when the recording began, if its stamps are dates
    derived : lost motion and stiffness, see `hysteresis_findings` and `lost_motion_of`, and `map_findings`
    rated : torque at which the lost motion is stated, N m at the output, and whether it was given
    slow : result of a slow torque on a resting output, or why the recording has none
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
