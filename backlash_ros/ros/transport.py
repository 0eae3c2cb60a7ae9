"""Fast DDS by UDP: through its shared memory a node may be held up by who stops, comes or leaves (docs/faults.md)."""

import os
from collections.abc import Mapping
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

LOOPBACK = Path(__file__).with_name("loopback_udp.xml")
"""Profile of Fast DDS: UDP on this machine alone."""

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
"""Where Fast DDS 2 and 3 look for a profile."""

_UNNAMED = "DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml"
"""Profiles that they take from the working folder."""

Variables = Mapping[str, str | None]
"""Environment variables; None is for one that must not be there."""

ON_LOOPBACK: Variables = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",  # LOCALHOST takes shared memory whatever a profile says
    "ROS_LOCALHOST_ONLY": None,
    **dict.fromkeys(PROFILES, str(LOOPBACK)),
}
"""What stands in for LOCALHOST where `may_use_loopback`: the profile keeps the process on this machine."""


def may_use_loopback() -> bool:
    """Return whether the RMW is Fast DDS, the profile is there and no other one would come in its way."""
    named = {Path(os.environ.get(name, "")).name for name in PROFILES}
    unnamed = os.environ.get("SKIP_DEFAULT_XML_FILE") != "1" and any(Path(name).exists() for name in _UNNAMED)
    fast_dds = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
    return fast_dds and named <= {"", LOOPBACK.name} and not unnamed and LOOPBACK.is_file()


def set_variables(variables: Variables) -> None:
    """Set environment variables of this process and of what it starts."""
    for name, value in variables.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


def _is_localhost() -> bool:
    """Return whether the user asks for this machine alone, and for no peer or server by its address."""
    if os.environ.get("ROS_STATIC_PEERS") or os.environ.get("ROS_DISCOVERY_SERVER"):
        return False
    only = os.environ.get("ROS_LOCALHOST_ONLY", "").startswith("1")
    return only or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"


def avoid_shared_memory() -> None:
    """Choose UDP for this process, before its first participant, where the user chose nothing else.

    A process that was asked for this machine alone stays on it.
    """
    by_udp = os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4") == "UDPv4"
    if by_udp and _is_localhost() and may_use_loopback():
        set_variables(ON_LOOPBACK)
