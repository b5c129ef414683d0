"""`follower track`: the vision and control stages on recorded or live video.

Uses: `flight`, `follower_vision`.
Start at: `session`, then `run.TrackRun`.
"""
