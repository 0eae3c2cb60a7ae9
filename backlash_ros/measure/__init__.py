"""What `backlash measure` does: lets a running controller measure its drive, records that, and certifies the drive."""
