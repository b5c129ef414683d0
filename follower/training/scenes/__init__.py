"""Generated sequences with a target: what our trackers learn from."""
