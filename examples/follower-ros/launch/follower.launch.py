"""Starts the lifecycle node with a camera's topic, configures and activates it.

ros2 launch follower_ros follower.launch.py image:=/camera/image_raw mode:=mavros
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the node and its arguments; `autostart` needs launch_ros of Jazzy or newer."""
    config = PathJoinSubstitution([FindPackageShare("follower_ros"), "config", "follower.yaml"])
    arguments = {
        "image": ("/camera/image_raw", "topic of the images"),
        "camera_info": ("/camera/camera_info", "topic of the lens"),
        "mode": ("perception", "perception, mavros or direct"),
        "params": (config, "file of parameters"),
        "use_sim_time": ("false", "take the time of /clock"),
    }
    node = LifecycleNode(
        package="follower_ros",
        executable="follower",
        name="follower",
        namespace="",
        output="screen",
        autostart=True,
        parameters=[
            LaunchConfiguration("params"),
            {
                "mode": LaunchConfiguration("mode"),
                "use_sim_time": LaunchConfiguration("use_sim_time"),
            },
        ],
        remappings=[(name, LaunchConfiguration(name)) for name in ("image", "camera_info")],
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=meaning)
        for name, (value, meaning) in arguments.items()
    ]
    return LaunchDescription([*declared, node])
