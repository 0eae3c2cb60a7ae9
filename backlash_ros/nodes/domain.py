"""A ROS domain of one's own on this machine, for the demo and for tests: claimed by a lock, released with it."""

import contextlib
import fcntl
import os
import random
import tempfile
from collections.abc import Iterator
from pathlib import Path

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


def isolated_environment(domain: int) -> dict[str, str]:
    """Return the environment variables that keep a process in ``domain`` and on this machine."""
    return {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
