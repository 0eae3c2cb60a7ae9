"""The plant in time: the integrator with its error control, and dry friction that sticks and slips."""
