"""A bag that is read back: what was in use is told in its order, whatever order a recorder heard it in."""

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from backlash_ros.recordings import read_bag

STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES: dict[str, Any] = STORE.types
EVENT = "rcl_interfaces/msg/ParameterEvent"


def integer(name: str, value: int) -> Any:
    """Return a parameter of the message, a whole number."""
    nothing = {
        "bool_value": False,
        "double_value": 0.0,
        "string_value": "",
        "string_array_value": [],
        "byte_array_value": np.empty(0, np.uint8),
        "bool_array_value": np.empty(0, np.bool_),
        "integer_array_value": np.empty(0, np.int64),
        "double_array_value": np.empty(0),
    }
    given = TYPES["rcl_interfaces/msg/ParameterValue"](type=2, integer_value=value, **nothing)
    return TYPES["rcl_interfaces/msg/Parameter"](name, given)


@pytest.mark.parametrize("heard", list(permutations([(1, 5.0), (2, 6.0), (3, 6.0)])))
@pytest.mark.parametrize(("node", "part"), [("controller", "in_use"), ("plant_simulator", "simulated")])
def test_versions_in_use_are_told_in_their_order(
    tmp_path: Path, node: str, part: str, heard: list[tuple[int, float]]
) -> None:
    """A recorder that finds a publisher hears the newest of it, and then what it kept; two may have the same time."""
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection(f"/{node}/parameters_in_use", EVENT, typestore=STORE)
        for receipt, (version, time) in enumerate(heard):
            stamp = TYPES["builtin_interfaces/msg/Time"](sec=int(time), nanosec=0)
            parameters = [integer("version", version), integer("cycles", 10 * version)]
            message = TYPES[EVENT](stamp, f"/{node}", parameters, [], [])
            writer.write(topic, 10**10 + receipt, STORE.serialize_cdr(message, EVENT))
    told = getattr(read_bag(tmp_path / "bag"), part)
    assert told == [(5.0, 1, {"cycles": 10}), (6.0, 2, {"cycles": 20}), (6.0, 3, {"cycles": 30})]
