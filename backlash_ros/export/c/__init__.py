"""Writes the controller of one axis as C: its tick as an object file, what is around it, and what proves it."""
