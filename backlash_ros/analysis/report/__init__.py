"""The report of a recording: one page with what happened in a bag, step by step, and how well it went."""
