"""The report of a recording: one page that shows what happened in a bag, step by step, and judges it."""
