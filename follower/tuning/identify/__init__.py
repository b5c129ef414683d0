"""`follower identify`: how a vehicle responds, from recordings of its flights.

Uses: `follower_control.tuning`, `recording`.
Start at: `run`.
"""
