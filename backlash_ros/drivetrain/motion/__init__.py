"""The plant in time: its equations of motion, their integration with error control, and friction that sticks."""
