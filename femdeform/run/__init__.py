"""Running a scene: wiring, time loop, results on disk."""
