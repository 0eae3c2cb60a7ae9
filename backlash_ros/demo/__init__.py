"""What `make demo` runs: the nodes as processes of their own, seen from outside, recorded and judged."""
