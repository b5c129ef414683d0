"""Training of a detector of the YOLO v2 family.

Uses: `follower_sim`'s renderer, torch, onnx.
Start at: `run`, `trainer.DetectorTrainer`.
"""
