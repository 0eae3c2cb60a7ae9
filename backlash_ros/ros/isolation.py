"""A ROS domain of one's own on this machine, for the demo and for tests: claimed by a lock, released with it."""

import contextlib
import fcntl
import os
import random
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

LOOPBACK = Path(__file__).with_name("loopback_udp.xml")
"""Profile of Fast DDS: UDP on this machine alone."""

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"
"""Where Fast DDS 2 and 3 look for a profile."""

_DOMAINS = range(1, 101)
"""Domain ids whose ports are free of the ephemeral range on every platform, without 0, which is everybody's."""


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Claim a domain id that nobody else who asks here holds; RuntimeError when all are taken."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        lock = Path(tempfile.gettempdir()) / f"backlash_ros_domain_{domain}.lock"
        try:
            descriptor = os.open(lock, os.O_CREAT | os.O_RDWR, 0o666)
        except PermissionError:
            continue  # another user's
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            continue
        try:
            yield domain
        finally:
            os.close(descriptor)
        return
    raise RuntimeError(f"no ROS domain is free between {_DOMAINS.start} and {_DOMAINS.stop - 1}")


def _variables(domain: int) -> dict[str, str | None]:
    """Return what keeps a process in ``domain`` and on this machine; None is for what must not be there.

    With Fast DDS by a profile without shared memory, by which a process that is stopped may hold up the others
    (docs/faults.md), unless the user has a profile of his own.
    """
    variables: dict[str, str | None] = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    profiles = {Path(os.environ.get(name, "")).name for name in PROFILES}
    fast_dds = get_rmw_implementation_identifier().startswith("rmw_fastrtps")
    if fast_dds and profiles <= {"", LOOPBACK.name} and LOOPBACK.is_file():
        variables |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": None}
        variables |= dict.fromkeys(PROFILES, str(LOOPBACK))
    return variables


def _set(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        os.environ.pop(name, None)
        if value is not None:
            os.environ[name] = value


@contextlib.contextmanager
def isolated() -> Iterator[int]:
    """Keep this process, and what it starts, on this machine and in a domain of its own, and give the domain's id.

    It does so by environment variables, which it puts back in the end, and so before the first participant: Fast DDS
    reads its profile once in a process. RuntimeError when all domains are taken.
    """
    with own_domain() as domain:
        variables = _variables(domain)
        before = {name: os.environ.get(name) for name in variables}
        _set(variables)
        try:
            yield domain
        finally:
            _set(before)
