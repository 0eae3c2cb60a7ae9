"""The file that describes a drive: read as the nodes read it, and written with a comment at each value."""
