"""The limits that every setpoint passes last: speed, acceleration, jerk, height, fence, distance.

Uses: `vehicle`, `common`.
Start at: `envelope.Envelope.limit`.
"""
