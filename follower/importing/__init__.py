"""`follower import`: makes a flight of a video and a telemetry log."""
