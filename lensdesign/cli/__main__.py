"""`python -m lensdesign.cli`."""

from lensdesign.cli import main

main()
