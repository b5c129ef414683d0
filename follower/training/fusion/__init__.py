"""Fits the probability by which Fusion chooses; `follower train fusion`.

Uses: `follower_vision.fusion`, `follower_vision.evaluation`.
Start at: `trainer.FusionTrainer`.
"""
