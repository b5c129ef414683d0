"""A world, a camera and an autopilot to fly against."""
