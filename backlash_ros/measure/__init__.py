"""`backlash measure`: lets a running controller measure its drive, records this, and certifies the drive."""

CERTIFICATE = "certificate.html"
"""The page in the folder of a measurement."""
