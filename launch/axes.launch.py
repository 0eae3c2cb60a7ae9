"""Several axes, each in its namespace: one process of simulators, one of controllers; with simulator:=false the latter."""

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription


def _nodes(context: LaunchContext) -> list[Node]:
    axes = LaunchConfiguration("axes").perform(context).replace(",", " ").split()
    gain_set = LaunchConfiguration("gain_set").perform(context)
    # Not named and not in a namespace here: each process makes one node per axis and names it itself.
    common = {
        "package": "backlash_ros",
        "arguments": ["--axes", *axes],
        "parameters": [LaunchConfiguration("config")],
        "output": "screen",
    }
    return [
        Node(executable="plant_simulator", condition=IfCondition(LaunchConfiguration("simulator")), **common),
        Node(executable="controller", ros_arguments=["-p", f"gain_set:={gain_set}"] if gain_set else [], **common),
    ]


def generate_launch_description() -> LaunchDescription:
    """Describe the launch for `ros2 launch backlash_ros axes.launch.py axes:=shoulder,elbow`."""
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
