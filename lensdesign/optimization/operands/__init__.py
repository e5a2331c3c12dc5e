"""Goals and constraints of a lens, as rows of scaled values with derivatives."""
