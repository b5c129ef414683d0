"""`follower tune`: what the follow loops are worth, and gains from a model."""
