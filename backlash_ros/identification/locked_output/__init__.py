"""A locked output: gap, lost motion and stiffness from the angle between the shafts under a slow torque."""
