"""`follower excite`: flies a pattern from which a vehicle's answers can be identified."""
