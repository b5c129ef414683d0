"""The code that flies: vision stage, control stage, supervision, and the two ways to run them.

Uses: `links`, `settings` and the packages below.
Start at: `control.stage.ControlStage.step`, then `threads` and `lockstep`.
"""
