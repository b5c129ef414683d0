"""From flights to gains: excite, identify, tune.

Uses: `follower_control.tuning`, `recording`, `report`.
Start at: `identify.run`, `tune.run`.
"""
