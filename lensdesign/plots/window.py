"""A window that shows the lens in 3D, opened by a child process: what kills it leaves its parent alive."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from lensdesign.common.input_files import allowed_folder
from lensdesign.errors import InputError

NO_DISPLAY_STATUS = 3

CHILD = f"""
import ctypes, ctypes.util, os, sys
if sys.platform.startswith("linux"):
    library = ctypes.util.find_library("X11") or "libX11.so.6"
    try:
        open_display = ctypes.CDLL(library).XOpenDisplay
    except OSError:
        raise SystemExit({NO_DISPLAY_STATUS})
    open_display.argtypes, open_display.restype = [ctypes.c_char_p], ctypes.c_void_p
    if not open_display(None):
        raise SystemExit({NO_DISPLAY_STATUS})
from lensdesign.files.design import load_design
from lensdesign.plots.scene3d import show_lens
from lensdesign.common.input_files import files_from
with files_from(sys.argv[2]):
    show_lens(load_design(sys.argv[1]))
os._exit(0)  # some drivers crash when they are unloaded
"""
"""VTK falls back to drawing unseen where the display does not answer, and waits for ever: so ask first."""


def open_window(design: str | os.PathLike[str]) -> None:
    """Show a design in a window, and return when it is closed.

    Parameters
    ----------
    design
        Design file.

    Raises
    ------
    InputError
        If there is no display, or no window can be opened on it.
    """
    if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise InputError(_refusal("there is no display"))
    path = Path(design).resolve()
    command = [sys.executable, "-P", "-c", CHILD, str(path), str(allowed_folder() or path.parent)]
    child = subprocess.run(command, check=False, capture_output=True, text=True)
    if child.returncode == NO_DISPLAY_STATUS:
        raise InputError(_refusal("the display does not answer"))
    if child.returncode != 0:
        said = child.stderr.strip().splitlines()
        raise InputError(_refusal(f"the window could not be opened ({said[-1] if said else 'it crashed'})"))


def _refusal(reason: str) -> str:
    return f"{reason}; write a page for a browser instead with -o view.html"
