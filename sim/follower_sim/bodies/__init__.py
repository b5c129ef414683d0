"""Low-poly bodies: person, car, boat, quadrotor.

Uses: `kinematics`.
Start at: `targets`.
"""
