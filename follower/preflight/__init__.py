"""The checks before a flight: a table of small functions of one snapshot."""
