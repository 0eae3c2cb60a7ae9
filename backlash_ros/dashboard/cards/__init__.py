"""The cards of the page, one file each."""
