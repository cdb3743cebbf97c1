"""Finite elements: discretization, conditions, and the function that a step minimises."""
