"""Consent to execute Python code that a study names: the file may be another person's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_is_trusted: ContextVar[bool] = ContextVar("user_code_is_trusted", default=False)


@contextmanager
def trust_user_code(trusted: bool = True) -> Iterator[None]:
    """Allow the Python code of studies that are read within the context to be executed.

    Without it, no study, specification or store causes Python code to be executed, whatever reads it. The
    commands' option `--trust` uses this function, and so do `load_study(path, trust=True)` and
    `open_store(path, trust=True)`.

    Parameters
    ----------
    trusted
        False leaves the consent as it is.

    Examples
    --------
    >>> from lensdesign import trust_user_code
    >>> from lensdesign.optimization import load_specification
    >>> with trust_user_code():
    ...     specification = load_specification("designs/as_built_spec.toml")
    """
    token = _is_trusted.set(trusted or _is_trusted.get())
    try:
        yield
    finally:
        _is_trusted.reset(token)


def is_user_code_trusted() -> bool:
    """Return whether Python code of a study that is read now may be executed."""
    return _is_trusted.get()
