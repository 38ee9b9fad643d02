"""All four nodes; the run ends when the plant has finished.

ros2 launch los_testbed testbed.launch.py params:=/path/to/run.yaml
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

NODES = ("plant", "estimator", "controller", "recorder")


def generate_launch_description() -> LaunchDescription:
    """Nodes with one parameter file."""
    default = Path(get_package_share_directory("los_testbed")) / "config" / "run.yaml"
    nodes = {
        name: Node(
            package="los_testbed",
            executable=name,
            parameters=[LaunchConfiguration("params")],
            output="screen",
        )
        for name in NODES
    }
    finished = OnProcessExit(
        target_action=nodes["plant"], on_exit=[EmitEvent(event=Shutdown(reason="the run is over"))]
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("params", default_value=str(default), description="parameter file"),
            *nodes.values(),
            RegisterEventHandler(finished),
        ]
    )
