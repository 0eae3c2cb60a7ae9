"""A drive from a recording: which part is fitted, what it tells and what not, how well that foretells the rest."""
