"""Scene files: schema, loading, overrides, checks, selections."""
