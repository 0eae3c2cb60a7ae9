"""The commands of `backlash`: arguments, the work of one command, what it prints and writes."""
