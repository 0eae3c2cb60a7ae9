"""The parameters of profiles: whether references have one, and the limits that are given for its motion."""

from dataclasses import dataclass
from typing import ClassVar

from backlash_ros.foundation.quantity import Validated, quantities, quantity

STEP, LIMITED, OF_DRIVE = PROFILE_MODES = "step", "limited", "auto"
"""How the setpoint goes to a reference: at once, within the limits given, or within what the drive can do."""

_LEAST = 1e-6
"""Smallest limit: a motion of a rad takes eleven days."""


@dataclass(frozen=True)
class ProfileParameters(Validated):
    """How the setpoint goes to a reference: ``mode`` is one of `PROFILE_MODES`.

    With `LIMITED` all three limits must be given, with `OF_DRIVE` they may lower those of the drive.
    """

    section: ClassVar[str] = "profile"

    mode: str = STEP
    velocity: float = quantity(
        "largest speed of the setpoint on its way to a reference; 0: not given",
        "rad/s",
        at_least=0,
        at_most=1e6,
        default=0.0,
    )
    acceleration: float = quantity(
        "largest acceleration of the setpoint on that way; 0: not given",
        "rad/s^2",
        at_least=0,
        at_most=1e9,
        default=0.0,
    )
    jerk: float = quantity(
        "largest jerk of the setpoint on that way; 0: not given",
        "rad/s^3",
        at_least=0,
        at_most=1e12,
        default=0.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode not in PROFILE_MODES:
            raise ValueError(f"profile.mode must be one of {list(PROFILE_MODES)}, got {self.mode!r}")
        for name, described in quantities(ProfileParameters).items():
            value, limited = getattr(self, name), self.mode == LIMITED
            if value < _LEAST and (value or limited):
                needed = f"with profile.mode = {LIMITED!r}" if limited else "or 0"
                raise ValueError(f"profile.{name} must be >= {_LEAST:g} {described.unit} {needed}, got {value!r}")
