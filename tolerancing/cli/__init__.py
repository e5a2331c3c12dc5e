"""The `tolerancing` command."""

from collections.abc import Callable

from lensdesign.common.startup import start_program


def main() -> None:
    """Run the console script; interrupts are handled from its first import on."""
    start_program(_import_main)


def _import_main() -> Callable[[], None]:
    from tolerancing.cli.commands import main

    return main
