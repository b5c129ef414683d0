"""`follower campaign`: many simulated flights, counted.

Uses: `simulation`; Dask, Optuna and PyArrow when asked for.
Start at: `run`, then `fly.fly_run`.
"""
