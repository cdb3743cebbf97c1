"""Position-based methods: sweeps over nodes or cells that move a few positions at a time."""
