"""Object and bench together, from the frames alone."""
