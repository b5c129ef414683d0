"""Boxes and states drawn on frames, and video files written.

Uses: `geometry`, `images`, OpenCV, PyAV.
Start at: `overlay`.
"""
