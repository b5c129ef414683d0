"""Generated sequences with a target, which our trackers learn from.

Uses: `training.detector`'s random worlds, `follower_sim`'s renderer, OpenCV.
Start at: `generator.SceneMaker`.
"""
