"""Paths of targets as closed forms over time.

Uses: `kinematics`.
Start at: `spline.TargetPath`.
"""
