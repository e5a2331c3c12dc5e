"""The `tolerancing` command."""

from lensdesign.common.interrupts import stoppable


def main() -> None:
    """Entry point of the console script: from its first import on it ends well when it is stopped."""
    with stoppable():
        from tolerancing.cli.commands import main

        main()
