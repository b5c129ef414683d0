"""`follower evaluate`: trackers measured over data sets."""
