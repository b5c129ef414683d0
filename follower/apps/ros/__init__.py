"""`follower ros`: the follower as a lifecycle node of ROS 2; bags; the simulator over ROS.

Uses: rclpy and ROS 2's messages, rosbags; the flight of `apps.api`, the simulator.
Start at: `command.ros_command`, `node.FollowerNode`.
"""
