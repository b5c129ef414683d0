"""Frames in, the target's box out.

Uses: NumPy, OpenCV and onnxruntime; nothing of the other three packages.
Start at: `fusion.tracker.FusionTracker`; `trackers.target_tracker` is what every tracker promises.
"""

import os

# Before it is loaded: else onnxruntime reports each start to its maker, under an identifier of this
# computer that it keeps in the user's cache.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
