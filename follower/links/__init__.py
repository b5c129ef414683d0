"""MAVLink to the autopilot by pymavlink and mavsdk: packets, vehicle state, setpoints.

Uses: `settings` and the packages below.
Start at: `link.Link`, then `open.open_link`.
"""
