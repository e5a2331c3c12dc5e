"""Runs the command with `python -m tolerancing.cli`."""

from tolerancing.cli import main

main()
