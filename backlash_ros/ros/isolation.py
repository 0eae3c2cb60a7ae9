"""An exclusive ROS domain on this machine, for the demo and for tests: claimed by a port, released with it."""

import contextlib
import errno
import os
import random
import socket
from collections.abc import Iterator
from pathlib import Path

from backlash_ros.ros.transport import ON_LOOPBACK, Variables, may_use_loopback, set_variables

_DOMAINS = range(1, 101)
"""Domain ids whose ports are outside the ephemeral range on every platform, without 0, the default domain."""


_PORTS = 250
"""UDP ports of a domain, from 7400 + 250 times its id: discovery and the traffic of its participants."""

_CLAIM = 9
"""Offset of the port that claims the domain: RTPS uses 0, 1, and from 10 on."""

_BOUND = Path("/proc/net/udp"), Path("/proc/net/udp6")
"""Linux lists the bound UDP ports of all users here."""


def _is_live(first_port: int) -> bool:
    """Return whether the domain has any participant; always False if the system does not show it."""
    tables = [table.read_text().splitlines()[1:] for table in _BOUND if table.exists()]
    bound = {int(row.split()[1].rpartition(":")[2], 16) for rows in tables for row in rows}
    return not bound.isdisjoint({*range(first_port, first_port + _PORTS)} - {first_port + _CLAIM})


@contextlib.contextmanager
def own_domain() -> Iterator[int]:
    """Claim a domain id without participants and without another claim, by any user of this machine.

    The claim is a bound port: it ends with its process, and leaves no file. RuntimeError if all are taken.
    """
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        first_port = 7400 + _PORTS * domain
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as claim:
            try:
                claim.bind(("127.0.0.1", first_port + _CLAIM))
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
                continue
            if not _is_live(first_port):
                yield domain
                return
    raise RuntimeError(f"no ROS domain is free between {_DOMAINS.start} and {_DOMAINS.stop - 1}")


def _variables(domain: int) -> Variables:
    """Return the variables that keep a process in ``domain`` and on this machine; None removes a variable.

    With Fast DDS this needs a profile without shared memory, since a stopped process may hold up the others there
    (docs/faults.md), unless the user has their own profile.
    """
    reach: Variables = ON_LOOPBACK if may_use_loopback() else {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {"ROS_DOMAIN_ID": str(domain), **reach}


@contextlib.contextmanager
def isolated() -> Iterator[int]:
    """Keep this process and its children on this machine and in an exclusive domain, and yield the domain's id.

    This uses environment variables, which are restored at the end. It must be done before the first participant: Fast
    DDS reads its profile once per process. RuntimeError if all domains are taken.
    """
    with own_domain() as domain:
        variables = _variables(domain)
        before = {name: os.environ.get(name) for name in variables}
        set_variables(variables)
        try:
            yield domain
        finally:
            set_variables(before)
