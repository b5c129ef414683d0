"""`follower campaign`: many simulated flights, counted.

Uses: `simulation`; Dask, Optuna and PyArrow when asked for.
Start at: `run`, then `engine.fly_run`.
"""
