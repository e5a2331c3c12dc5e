"""The `tolerancing` command."""

from lensdesign.common.interrupts import stoppable


def main() -> None:
    """Run the command line. An interrupt is handled from the first import on."""
    with stoppable():
        from tolerancing.cli.commands import main

        main()
