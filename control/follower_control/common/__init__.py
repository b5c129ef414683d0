"""What all of control needs: clamping, clock offsets, strict configuration, byte transports.

Uses: The standard library, NumPy and pydantic.
Start at: `strict_config`.
"""
