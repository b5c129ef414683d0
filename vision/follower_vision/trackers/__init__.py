"""Motion trackers: correlation filter, Re3, NanoTrack, OpenCV's; and the two tracker interfaces.

Uses: `geometry`, `images`, `onnx_network`.
Start at: `motion_tracker.MotionTracker`, `target_tracker.TargetTracker`, `registry`.
"""
