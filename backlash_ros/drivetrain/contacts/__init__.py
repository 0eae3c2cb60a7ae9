"""The contact laws by name: a file in this folder adds one, and so does `CONTACTS.add` for a file from anywhere.

Such a file has a table ``CONTACTS = {"name": Class}`` of subclasses of `contact.Contact`.
"""

from backlash_ros.drivetrain.contact import Contact
from backlash_ros.foundation.registry import Registry

CONTACTS: Registry[type[Contact]] = Registry(__name__, list(__path__), "CONTACTS", first="power")
"""Each law's class, which holds its parameters and its compiled functions."""

__all__ = ["CONTACTS"]
