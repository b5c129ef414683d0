"""`follower bench`: what this computer holds, measured with the program's own threads.

Uses: `flight`, `recording`, `follower_sim`, `report`.
Start at: `run`, then `measure.measure`.
"""
