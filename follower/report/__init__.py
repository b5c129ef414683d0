"""Drawing kit for HTML reports, and the flight page.

Uses: `flight` and below, matplotlib.
Start at: `flight_page.write_report`.
"""
