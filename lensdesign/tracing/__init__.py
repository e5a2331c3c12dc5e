"""Where rays go: the compiled lens, bundles, the trace, its derivatives and its extremes."""
