"""What a ground station sees of the follower: a camera that tracks, and parameters."""
