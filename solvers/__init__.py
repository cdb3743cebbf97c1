"""How a step, or a linear system, is solved."""
