"""A drone target follower: the application."""

import os

# The matrices of trackers and filters are small: BLAS threads would gain nothing and take the
# cores from camera, vision and control. numpy reads this when it is first imported; a choice of
# the user's own stands.
os.environ.setdefault("OMP_NUM_THREADS", "1")
