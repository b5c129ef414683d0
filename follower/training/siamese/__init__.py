"""Training of our Siamese motion tracker.

Uses: `training.scenes`, torch, onnx.
Start at: `run`, `trainer.SiameseTrainer`.
"""
