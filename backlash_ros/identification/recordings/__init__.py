"""A drive from a recording: the part that is fitted, the findings, and how well these predict the rest."""
