"""Several axes in namespaces: a process of simulators and one of controllers; simulator:=false, the latter alone."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription


def _nodes(context: LaunchContext) -> list[Node]:
    def chosen(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    config = chosen("config")
    if not Path(config).is_file():  # launch_ros would only warn, and the drives be others
        raise FileNotFoundError(f"config: there is no file {config!r}")
    # What is given here stands on the command lines of the nodes, and so wins over the file.
    both = ["--log-level", chosen("log_level")]
    both += ["-p", f"use_sim_time:={chosen('use_sim_time')}"] if chosen("use_sim_time") else []
    alone = ["-p", f"gain_set:={chosen('gain_set')}"] if chosen("gain_set") else []
    # No name and no namespace here: each process makes one node per axis.
    common = {
        "package": "backlash_ros",
        "arguments": ["--axes", *chosen("axes").replace(",", " ").split()],
        "parameters": [config],
        "output": "screen",
    }
    with_simulator = IfCondition(chosen("simulator"))
    return [
        Node(executable="plant_simulator", ros_arguments=both, condition=with_simulator, **common),
        Node(executable="controller", ros_arguments=[*both, *alone], **common),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch for `ros2 launch backlash_ros axes.launch.py`."""
    config = PathJoinSubstitution([FindPackageShare("backlash_ros"), "config", "six_axes.yaml"])
    six = ",".join(f"axis{k}" for k in range(1, 7))
    switch, levels = ["true", "false"], ["debug", "info", "warn", "error", "fatal"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("axes", default_value=six, description="namespaces, separated by commas or spaces"),
            DeclareLaunchArgument("config", default_value=config, description="parameter file of all axes"),
            DeclareLaunchArgument("gain_set", default_value="", description="gain set of every axis, not the file's"),
            DeclareLaunchArgument(
                "simulator", default_value="true", choices=switch, description="false where there are drives"
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="", choices=["", *switch], description="in place of the file's"
            ),
            DeclareLaunchArgument("log_level", default_value="info", choices=levels, description="of all nodes"),
            OpaqueFunction(function=_nodes),
        ]
    )
