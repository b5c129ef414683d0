"""Frames in, the target's box out."""
