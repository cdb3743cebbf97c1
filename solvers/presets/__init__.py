"""Named, commented option sets for linear solvers, as YAML files beside this module."""
