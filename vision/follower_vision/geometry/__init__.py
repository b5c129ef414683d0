"""Boxes, the camera model, lines of sight.

Uses: NumPy alone.
Start at: `box.Box`, `camera_model.CameraModel`.
"""
