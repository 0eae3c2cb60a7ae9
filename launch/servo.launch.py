"""Simulator and controller; with simulator:=false the controller alone, for a real drive."""

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
    if not Path(config).is_file():  # launch_ros would only warn, and the drive be another one
        raise FileNotFoundError(f"config: there is no file {config!r}")
    # What is given here stands on the command lines of the nodes, and so wins over the file.
    both = ["--log-level", chosen("log_level")]
    both += ["-p", f"use_sim_time:={chosen('use_sim_time')}"] if chosen("use_sim_time") else []
    alone = ["-p", f"gain_set:={chosen('gain_set')}"] if chosen("gain_set") else []
    common = {
        "package": "backlash_ros",
        "namespace": chosen("namespace"),
        "parameters": [config],
        "output": "screen",
    }
    with_simulator = IfCondition(chosen("simulator"))
    return [
        Node(executable="plant_simulator", ros_arguments=both, condition=with_simulator, **common),
        Node(executable="controller", ros_arguments=[*both, *alone], **common),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch for `ros2 launch backlash_ros servo.launch.py`."""
    default = PathJoinSubstitution([FindPackageShare("backlash_ros"), "config", "nominal_drive.yaml"])
    switch, levels = ["true", "false"], ["debug", "info", "warn", "error", "fatal"]
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=default, description="parameter file"),
            DeclareLaunchArgument("gain_set", default_value="", description="gain set, in place of the file's"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of both nodes"),
            DeclareLaunchArgument(
                "simulator", default_value="true", choices=switch, description="false where there is a drive"
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="", choices=["", *switch], description="in place of the file's"
            ),
            DeclareLaunchArgument("log_level", default_value="info", choices=levels, description="of both nodes"),
            OpaqueFunction(function=_nodes),
        ]
    )
