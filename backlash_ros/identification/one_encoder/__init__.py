"""A drive with one encoder, at the output: a position servo that is simulated freely and fitted to recordings."""
