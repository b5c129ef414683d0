"""A drone target follower: the application."""

import os

# The matrices of trackers and filters are small: BLAS threads would gain nothing and take the cores
# from camera, vision and control. Read by numpy when it is first imported; the user's choice stands.
os.environ.setdefault("OMP_NUM_THREADS", "1")
