"""Scripts that time other codes; each is run by the Python of the environment that holds them (`make peers`)."""
