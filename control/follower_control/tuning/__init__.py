"""Models of the follow loops, and gains from them. Nothing else uses python-control or SciPy.

Uses: All of `follower_control`.
Start at: `response_model.ResponseModel`, `axes`, `synthesis`.

`ResponseModel` says how a vehicle answers a velocity or yaw rate, `fit_response` finds one from a
recording with confidence intervals. `axis_loop` puts vehicle, estimator, delays and PID together
for one axis; `margins_of` says what it is worth, `tune` finds gains for it.

scipy and python-control are imported here and by the commands `identify` and `tune` alone, never in
flight.
"""
