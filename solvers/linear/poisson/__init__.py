"""Solvers of the pressure system of a MAC grid."""
