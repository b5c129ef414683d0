"""The Python API: what `import follower` offers beyond the types of the floors below.

Uses: the commands' folders beside it.
Start at: `tracking.Fusion`, `pursuit.Pursuit`.
"""
