"""Fields on grids, and their way through free space."""
