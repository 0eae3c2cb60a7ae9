"""The paper's law by design: over-damped gains and the width of their region that stay quiet over a range of drives."""
