"""The page that judges the paper."""
