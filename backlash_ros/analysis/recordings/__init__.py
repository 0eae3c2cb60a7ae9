"""Reads recordings of any drive, from bags and tables, for identification."""
