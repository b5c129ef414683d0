"""The PID visual servo: errors, follow modes, search, gimbal.

Uses: `target`, `vehicle`, `common`.
Start at: `servo.VisualServo`, `settings.ServoSettings`.
"""
