"""The follower flown in `follower_sim`.

Uses: `follower_sim`, `flight`, `ui`, `recording`, `report`.
Start at: `run`, then `flight.SimulatedFlight`.
"""
