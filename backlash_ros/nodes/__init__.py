"""The nodes, one a file: parameters and messages in, gate and tick, messages out."""

import os

# Gains are designed on matrices of a few rows, between two samples: threads that wait for each other only delay that.
# Read when numpy is first imported.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
