"""Linear systems: PETSc, and the SciPy fallback."""
