"""`follower faults`: the matrix of faults, process faults, and random flights.

Uses: `simulation`.
Start at: `command`, then `run_fault`.
"""
