"""`follower import`: a flight from a video and a telemetry log.

Uses: `recording`, `flight`.
Start at: `session`.
"""
