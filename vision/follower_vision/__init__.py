"""Frames in, the target's box out.

Uses: NumPy, OpenCV and onnxruntime; nothing of the other three packages.
Start at: `fusion.tracker.FusionTracker`; `trackers.target_tracker` is what every tracker promises.
"""
