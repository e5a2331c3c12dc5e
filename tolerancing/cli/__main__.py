"""`python -m tolerancing.cli`."""

from tolerancing.cli.commands import main

main()
