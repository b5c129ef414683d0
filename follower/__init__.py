"""A drone target follower: the application."""
