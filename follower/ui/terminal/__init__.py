"""The flight's line on the terminal, keyboard, Ctrl-C, shared command-line options.

Uses: rich, typer.
Start at: `flight_display.FlightDisplay`.
"""
