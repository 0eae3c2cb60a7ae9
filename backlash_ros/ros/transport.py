"""Fast DDS over UDP: with its shared memory, nodes that stop, join or leave may hold up others (docs/faults.md)."""

import os
from collections.abc import Mapping
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

LOOPBACK = Path(__file__).with_name("loopback_udp.xml")
"""Profile of Fast DDS: UDP on this machine alone."""

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
"""Variables with which Fast DDS 2 and 3 find a profile."""

_UNNAMED = "DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml"
"""Profiles that they read from the working folder."""

Variables = Mapping[str, str | None]
"""Environment variables; None removes a variable."""

ON_LOOPBACK: Variables = {
    "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",  # LOCALHOST uses shared memory despite a profile
    "ROS_LOCALHOST_ONLY": None,
    **dict.fromkeys(PROFILES, str(LOOPBACK)),
}
"""Replacement for LOCALHOST if `may_use_loopback`: the profile keeps the process on this machine."""


def may_use_loopback() -> bool:
    """Return whether the RMW is Fast DDS, the profile exists and no other profile interferes."""
    named = {Path(os.environ.get(name, "")).name for name in PROFILES}
    unnamed = os.environ.get("SKIP_DEFAULT_XML_FILE") != "1" and any(Path(name).exists() for name in _UNNAMED)
    fast_dds = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
    return fast_dds and named <= {"", LOOPBACK.name} and not unnamed and LOOPBACK.is_file()


def set_variables(variables: Variables) -> None:
    """Set environment variables of this process and its children."""
    for name, value in variables.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


def _is_localhost() -> bool:
    """Return whether the user restricts ROS to this machine, without peers or servers by address."""
    if os.environ.get("ROS_STATIC_PEERS") or os.environ.get("ROS_DISCOVERY_SERVER"):
        return False
    only = os.environ.get("ROS_LOCALHOST_ONLY", "").startswith("1")
    return only or os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"


def avoid_shared_memory() -> None:
    """Choose UDP for this process, before its first participant, unless the user chose otherwise.

    A process that is restricted to this machine stays restricted.
    """
    by_udp = os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4") == "UDPv4"
    if by_udp and _is_localhost() and may_use_loopback():
        set_variables(ON_LOOPBACK)
