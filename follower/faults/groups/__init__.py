"""The catalogue's faults, group by group."""
