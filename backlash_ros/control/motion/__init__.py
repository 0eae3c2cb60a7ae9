"""How things move over time: setpoints of the load, and moves of the motor alone."""
