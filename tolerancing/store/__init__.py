"""Where trials are kept: one SQLite file that survives being killed."""
