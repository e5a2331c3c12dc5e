"""Start of the commands: signals are handled from the first import on; too little memory is one message."""

from __future__ import annotations

import sys
from collections.abc import Callable

from lensdesign.common.interrupts import stoppable

SMALLEST_ADDRESS_SPACE_BYTES = 700_000_000
"""Address space that the compiled libraries need before a command does anything."""


def start_program(import_main: Callable[[], Callable[[], None]]) -> None:
    """Import the main function of a program and call it.

    Parameters
    ----------
    import_main
        Function that imports the main function, and with it the libraries, and returns it.
    """
    with stoppable():
        limit = _address_space_bytes()
        if limit < SMALLEST_ADDRESS_SPACE_BYTES:
            _end(f"this process may use {limit / 1e9:.2f} GB of address space")
        try:
            import_main()()
        except ImportError as error:
            # The loader states only in words that memory was missing.
            if "failed to map segment" in str(error) or "annot allocate memory" in str(error):
                _end(f"a library cannot be loaded: {error}")
            raise


def _address_space_bytes() -> float:
    """Return the limit of the address space and of the data segment; infinity without limits."""
    try:
        import resource
    except ImportError:  # Windows
        return float("inf")
    limits = [resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA)]
    return min((one for one in limits if one != resource.RLIM_INFINITY), default=float("inf"))


def _end(fault: str) -> None:
    print(
        f"error: not enough memory: {fault}; at least {SMALLEST_ADDRESS_SPACE_BYTES / 1e9:g} GB are needed "
        "(see `ulimit -v`)",
        file=sys.stderr,
    )
    raise SystemExit(2)
