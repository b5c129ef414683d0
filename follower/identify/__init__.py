"""`follower identify`: how a vehicle answers, from recordings of its flights."""
