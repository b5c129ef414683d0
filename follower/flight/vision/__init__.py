"""The vision step: a frame in, a track out.

Uses: `flight.target`, `follower_vision`.
Start at: `stage.VisionStage.step`.
"""
