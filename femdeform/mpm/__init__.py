"""Background grid: B-spline weights, transfers between points and grid, step problems over grid nodes."""
