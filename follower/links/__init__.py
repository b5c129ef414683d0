"""Links to the autopilot."""
