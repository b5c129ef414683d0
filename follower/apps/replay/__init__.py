"""`follower replay`: a recorded flight through the code that flies, and what differs.

Uses: `recording`, `flight`.
Start at: `replay.Replay`, `comparison`.
"""
