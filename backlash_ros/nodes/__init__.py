"""The ROS 2 side: plant simulator, controller, recorder and the demo that runs all three."""

import os

# Gains are designed on matrices of a few rows, between two samples: threads that wait for each other only delay that.
# Read when numpy is first imported.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
