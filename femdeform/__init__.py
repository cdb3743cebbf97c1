"""Large-deformation simulation: what is simulated, and how a run is wired."""
