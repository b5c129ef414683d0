"""The follower for `ros2 run follower_ros follower`."""
