"""The specification of an optimization and its tables."""
