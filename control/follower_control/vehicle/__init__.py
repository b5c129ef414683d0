"""What is known of the vehicle: its state, attitude and position histories, the gimbal, setpoints.

Uses: `common`.
Start at: `state.VehicleState`, `setpoint.VelocitySetpoint`.
"""
