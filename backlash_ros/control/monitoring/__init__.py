"""What a sample is held against before it is believed: limits, physics, and the faults that come of it."""
