"""`follower tune`: margins of the follow loops, and better gains.

Uses: `follower_control.tuning`, `report`.
Start at: `run`.
"""
