"""The target's box in, velocity setpoints out."""
