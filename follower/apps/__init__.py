"""The commands, one folder or module each.

Uses: Everything below.
Start at: `main`.
"""
