"""Starts the lifecycle node with a camera's topic, configures and activates it.

ros2 launch follower_ros follower.launch.py image:=/camera/image_raw mode:=mavros namespace:=drone
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition


def generate_launch_description() -> LaunchDescription:
    """Return the node and its arguments; once configured it is activated."""
    config = PathJoinSubstitution([FindPackageShare("follower_ros"), "config", "follower.yaml"])
    arguments = {
        "namespace": ("", "of the node, its topics and MAVROS"),
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
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        sigterm_timeout="90",  # it brakes, releases and closes the recording first
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
    configured = OnStateTransition(
        target_lifecycle_node=node,
        start_state="configuring",
        goal_state="inactive",
        entities=[_change(node, Transition.TRANSITION_ACTIVATE)],
    )
    configure = _change(node, Transition.TRANSITION_CONFIGURE)
    return LaunchDescription([*declared, RegisterEventHandler(configured), node, configure])


def _change(node: LifecycleNode, transition: int) -> EmitEvent:
    event = ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
    return EmitEvent(event=event)
