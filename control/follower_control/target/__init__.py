"""What is believed of the target: observations, the Kalman filter, its place in the world.

Uses: `common`, `vehicle`, filterpy.
Start at: `observation.BearingObserver`, then `estimator.TargetEstimator`.
"""
