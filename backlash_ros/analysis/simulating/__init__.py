"""`backlash simulate`: one step response of a drive, offline: figures, a picture, a table."""
