"""A MAVLink camera with tracking, and parameters, for QGroundControl.

Uses: `links`, `flight`.
Start at: `server.GroundStation`.
"""
