"""The user's cache folder, and codes by which a user's own data are known wherever they lie.

The folder holds data that the toolkit can compute again, and that no other user can write.
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import secrets
import sys
from pathlib import Path

KEY_BYTES = 32
"""Length of the key of the codes."""


def user_cache_folder() -> Path:
    """Return the toolkit's folder in the user's cache folder; it need not exist.

    The cache folder is ``XDG_CACHE_HOME`` if this is an absolute path. Otherwise it is that of the platform:
    ``~/Library/Caches`` on macOS, ``LOCALAPPDATA`` on Windows, and ``~/.cache`` elsewhere.
    """
    stated = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(stated):
        home = Path(stated)
    elif sys.platform == "darwin":
        home = Path.home() / "Library" / "Caches"
    elif sys.platform == "win32":
        home = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        home = Path.home() / ".cache"
    return home / "transferlens"


def user_key() -> bytes:
    """Return the user's key of codes, which is created in the cache folder at the first time."""
    path, new = user_cache_folder() / "key", secrets.token_bytes(KEY_BYTES)
    with contextlib.suppress(OSError):  # it exists, or there is no cache folder
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(new)
    try:
        return path.read_bytes() or new
    except OSError:  # without a cache folder, the next run knows no data as its own
        return new


def user_code(data: bytes, key: bytes) -> str:
    """Return the code (HMAC, RFC 2104) of data, which only a holder of the key can compute."""
    return hmac.new(key, data, hashlib.sha256).hexdigest()


def has_user_code(data: bytes, code: object, key: bytes) -> bool:
    """Return whether a code is that of the data."""
    return isinstance(code, str) and hmac.compare_digest(code.encode(), user_code(data, key).encode())
