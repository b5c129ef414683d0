"""`follower excite`: flies a pattern from which a vehicle's response can be identified.

Uses: `flight`, `links`.
Start at: `run`.
"""
