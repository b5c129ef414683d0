"""Faults that are put into simulated flights, and what must come of them."""
