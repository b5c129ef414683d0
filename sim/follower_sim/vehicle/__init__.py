"""A multirotor that answers velocity setpoints as recorded autopilots do.

Uses: `kinematics`.
Start at: `vehicle.SimulatedVehicle`.
"""
