"""`python -m lensdesign.cli`."""

from lensdesign.cli.commands import main

main()
