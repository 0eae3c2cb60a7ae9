"""What `backlash measure` does: lets a running controller measure its drive, records that, and certifies the drive."""

CERTIFICATE = "certificate.html"
"""The page that a measurement leaves in its folder."""
