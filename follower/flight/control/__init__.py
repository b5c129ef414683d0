"""The control step: estimate, supervise, guide, limit, send.

Uses: `flight.supervision`, `links`.
Start at: `stage.ControlStage.step`.
"""
