"""Training of our small Re3.

Uses: `training.scenes`, torch, onnx.
Start at: `run`, `trainer.Re3Trainer`.
"""
