"""Recordings of any drive, from bags and tables, as what identification takes."""
