"""Which samples a controller takes, which commands a drive takes, and what is a fault: without ROS, for any adapter."""
