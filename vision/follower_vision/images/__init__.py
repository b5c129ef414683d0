"""Frames, crops, and the rotation between two frames.

Uses: `geometry`, OpenCV.
Start at: `frame.Frame`.
"""
