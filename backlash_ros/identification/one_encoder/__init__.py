"""The gap from a recording of one encoder, and the drive with it: a fit without the other shaft's angle."""
