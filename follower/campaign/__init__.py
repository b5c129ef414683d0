"""Monte-Carlo campaigns: many simulated flights, counted."""
