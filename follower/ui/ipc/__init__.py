"""A process beside the flight that shows it to people and brings back what they want.

Video and web pages are work, and their libraries are large: none of that is to slow down, or take
down with it, the process that steers a vehicle.
"""
