"""Contact with rigid obstacles."""
