"""Object detectors behind one interface, and the ONNX networks that they read."""

from follower_vision.detection.detection import Detection, Detector
from follower_vision.detection.detectors import detector_names, make_detector
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.detection.settings import DetectorSettings

__all__ = [
    "Detection",
    "Detector",
    "DetectorSettings",
    "OnnxDetector",
    "detector_names",
    "make_detector",
]
