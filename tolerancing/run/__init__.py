"""Trials by worker processes and clusters, into a store."""
