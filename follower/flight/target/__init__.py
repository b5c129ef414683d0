"""How a target is chosen: by box, point, colour or detected object.

Uses: `follower_vision`.
Start at: `request.TargetRequest`.
"""
