"""The `lensdesign` command."""

from lensdesign.common.interrupts import stoppable


def main() -> None:
    """Run the console script; interrupts are handled from its first import on."""
    with stoppable():
        from lensdesign.cli.commands import main

        main()
