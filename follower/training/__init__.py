"""Training of the project's own networks; the only package that imports torch."""
