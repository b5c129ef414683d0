"""`follower sitl`: scenarios flown on real autopilots in software-in-the-loop.

Uses: `simulation.run` and `simulation.sitl`.
Start at: `run.fly_matrix`.
"""
