"""The plant in time: equations of motion, linear models, integration with error control, friction that sticks."""
