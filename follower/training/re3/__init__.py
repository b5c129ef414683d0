"""Training of our small Re3."""
