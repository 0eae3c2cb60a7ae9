"""What a recording tells of a drive: the gap, the load, friction, and how sure that is. No ROS, no clock."""
