"""Every key of the YAML file, one model per section; loading, live change, saving.

Uses: `follower_control`, `follower_vision`.
Start at: `settings.Settings`.
"""
