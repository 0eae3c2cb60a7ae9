"""The ROS 2 side: plant simulator, controller, recorder and the demo that runs all three."""

import os

# Before numpy is loaded: the matrices here are 3 x 3, for which other threads only make the loop wait.
os.environ.setdefault("OMP_NUM_THREADS", "1")
