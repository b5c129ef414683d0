"""A drone target follower: the application.

Uses: `follower_vision`, `follower_control`, `follower_sim`.
Start at: `flight.control.stage.ControlStage`; `apps.main` has the commands.
"""

import numpy  # noqa: F401  (loads the BLAS that is limited below)
from threadpoolctl import threadpool_limits

# How a matrix product is split among threads decides its last bits: one thread, so that the same
# recording gives the same setpoints whatever the machine's cores. The matrices of trackers and
# filters are small: threads would gain nothing and take cores from camera, vision and control.
threadpool_limits(1, user_api="blas")
