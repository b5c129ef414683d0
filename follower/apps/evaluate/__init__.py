"""`follower evaluate`: trackers measured over data sets.

Uses: `follower_vision.evaluation`, `report`.
Start at: `run`.
"""
