"""The nodes, one per file: parameters and messages in, gate and tick, messages out."""

import os

# Gains are designed with small matrices between two samples, where several threads only cause delay. The variable is
# read when numpy is first imported.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
