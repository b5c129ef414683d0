"""Models of the follow loops, and gains from them.

`ResponseModel` says how a vehicle answers a velocity or yaw rate, `fit_response` finds one from a
recording with confidence intervals. `axis_loop` puts vehicle, estimator, delays and PID together
for one axis; `margins_of` and `closed_loop` say what it is worth, `tune` finds gains for it.

scipy and python-control are imported here and by the commands `identify` and `tune` alone, never in
flight.
"""
