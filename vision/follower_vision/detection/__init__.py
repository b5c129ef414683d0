"""Object detectors behind one interface, and the ONNX layouts they read.

Uses: `geometry`, `images`, `models`, `onnx_network`.
Start at: `detection.Detector`, then `onnx_detector.OnnxDetector`.
"""

from follower_vision.detection.detection import Detection, Detector, DetectorSettings
from follower_vision.detection.detectors import detector_names, make_detector
from follower_vision.detection.onnx_detector import OnnxDetector

__all__ = [
    "Detection",
    "Detector",
    "DetectorSettings",
    "OnnxDetector",
    "detector_names",
    "make_detector",
]
