"""`follower doctor`: whether this computer and installation are fit, without a vehicle.

Uses: `apps.preflight`, `links`.
Start at: `checks.DOCTOR_CHECKS`, `reading.read_installation`.
"""
