"""The demo of `make demo`: the nodes as processes, seen from outside, recorded and judged."""
