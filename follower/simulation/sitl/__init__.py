"""Autopilots in software-in-the-loop, each started as a program of its own.

Uses: `follower_sim`, `links`; the user's own builds of ArduCopter and PX4.
Start at: `programs`, then `process`.
"""
