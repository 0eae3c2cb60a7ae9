"""Several axes in namespaces: a process of simulators and one of controllers; simulator:=false, the latter alone."""

import json
from pathlib import Path
from tempfile import NamedTemporaryFile

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription


def _file_of(axes: list[str], gain_set: str) -> str:
    """Write a parameter file that chooses a gain set by each controller's full name, which wins over wildcards."""
    chosen = {f"/{axis.strip('/')}/controller": {"ros__parameters": {"gain_set": gain_set}} for axis in axes}
    with NamedTemporaryFile("w", prefix="gain_set_", suffix=".yaml", delete=False) as file:
        json.dump(chosen, file)  # JSON is YAML
    return file.name


def _nodes(context: LaunchContext) -> list[Node]:
    axes = LaunchConfiguration("axes").perform(context).replace(",", " ").split()
    gain_set = LaunchConfiguration("gain_set").perform(context)
    config = LaunchConfiguration("config").perform(context)
    if not Path(config).is_file():  # launch_ros would only warn, and the drives be others
        raise FileNotFoundError(f"config: there is no file {config!r}")
    # No name and no namespace here: each process makes one node per axis.
    common = {"package": "backlash_ros", "arguments": ["--axes", *axes], "output": "screen"}
    with_simulator = IfCondition(LaunchConfiguration("simulator"))
    given = [_file_of(axes, gain_set)] if gain_set else []
    return [
        Node(executable="plant_simulator", parameters=[config], condition=with_simulator, **common),
        Node(executable="controller", parameters=[config, *given], **common),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch for `ros2 launch backlash_ros axes.launch.py`."""
    config = PathJoinSubstitution([FindPackageShare("backlash_ros"), "config", "six_axes.yaml"])
    six = ",".join(f"axis{k}" for k in range(1, 7))
    return LaunchDescription(
        [
            DeclareLaunchArgument("axes", default_value=six, description="namespaces, separated by commas or spaces"),
            DeclareLaunchArgument("config", default_value=config, description="parameter file of all axes"),
            DeclareLaunchArgument("gain_set", default_value="", description="gain set of every axis, not the file's"),
            DeclareLaunchArgument("simulator", default_value="true", description="false where there are drives"),
            OpaqueFunction(function=_nodes),
        ]
    )
