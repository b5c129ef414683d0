"""`follower fly`: a real vehicle and a real camera.

Uses: `flight`, `links`, `apps.preflight`.
Start at: `session`, then `flight.RealFlight`.
"""
