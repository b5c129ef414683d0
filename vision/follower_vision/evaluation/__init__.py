"""One-pass evaluation over data sets: success, precision, state accuracy.

Uses: `sources`, `trackers`.
Start at: `one_pass`, `metrics`.
"""
