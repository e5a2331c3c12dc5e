"""Utilities of all packages: console, text, input and output files, notebooks, clusters."""
