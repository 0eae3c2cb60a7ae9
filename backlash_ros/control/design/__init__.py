"""Gains and what they do: LQR weights, named sets, stability with delay, margins, and the limit cycle they keep up."""
