"""The target's box in, velocity setpoints out.

Uses: `follower_vision`'s boxes, frames and camera model; no network, no thread, no socket, no BLAS.
Start at: `servo.servo.VisualServo`, then `envelope.envelope.Envelope`.
"""
