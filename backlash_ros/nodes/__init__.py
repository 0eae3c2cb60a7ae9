"""The ROS 2 side: plant simulator, controller, recorder and the demo that runs all three."""
