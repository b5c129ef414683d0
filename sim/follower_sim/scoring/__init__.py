"""Ground truth and the score of a pursuit; nothing here reaches vision or control.

Uses: `scenario`, `world`.
Start at: `score.PursuitScore`.
"""
