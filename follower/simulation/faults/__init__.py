"""Faults that are injected into simulated flights, and the judge of what came of them.

Uses: `simulation`.
Start at: `fault.Fault`, `judge`.
"""
