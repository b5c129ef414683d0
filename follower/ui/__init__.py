"""What operators see and press: terminal, cockpit, ground station, live video.

Uses: `flight` and below.
Start at: `cockpit.publisher`, `ground_station.server`.
"""
