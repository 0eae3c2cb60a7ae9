"""Simulator and controller; with simulator:=false the controller alone, for a real drive."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription


def _check_config(context: LaunchContext) -> None:
    """Start nothing without the parameter file: launch_ros would only warn, and the drive be another one."""
    if not Path(config := LaunchConfiguration("config").perform(context)).is_file():
        raise FileNotFoundError(f"config: there is no file {config!r}")


def generate_launch_description() -> LaunchDescription:
    """Describe the launch for `ros2 launch backlash_ros servo.launch.py`."""
    default = PathJoinSubstitution([FindPackageShare("backlash_ros"), "config", "nominal_drive.yaml"])
    config, namespace = LaunchConfiguration("config"), LaunchConfiguration("namespace")
    common = {"package": "backlash_ros", "namespace": namespace, "output": "screen"}
    # Named, so that what is given here is addressed to the node and wins over the file's wildcards.
    given = PythonExpression(["'", LaunchConfiguration("gain_set"), "' != ''"])
    gain_set = {"gain_set": LaunchConfiguration("gain_set")}
    return LaunchDescription(
        [
            DeclareLaunchArgument("config", default_value=default, description="parameter file"),
            DeclareLaunchArgument("gain_set", default_value="", description="gain set, in place of the file's"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of both nodes"),
            DeclareLaunchArgument("simulator", default_value="true", description="false where there is a drive"),
            OpaqueFunction(function=_check_config),
            Node(
                executable="plant_simulator",
                name="plant_simulator",
                parameters=[config],
                condition=IfCondition(LaunchConfiguration("simulator")),
                **common,
            ),
            Node(
                executable="controller",
                name="controller",
                parameters=[config],
                condition=UnlessCondition(given),
                **common,
            ),
            Node(
                executable="controller",
                name="controller",
                parameters=[config, gain_set],
                condition=IfCondition(given),
                **common,
            ),
        ]
    )
