"""Sequences on which trackers fail, made from others by a program."""
