"""The user's cache folder: data that the toolkit can compute again, and that no other user can write."""

from __future__ import annotations

import os
import sys
from pathlib import Path


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
