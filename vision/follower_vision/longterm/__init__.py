"""Track states and re-identification around a motion tracker, without a detector.

Uses: `appearance`, `trackers`.
Start at: `tracker.LongTermTracker`.
"""
