"""Window that shows the lens in 3D, in a child process, whose crash does not affect the parent."""

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
"""Script of the child. It tests the display first: without one, VTK renders invisibly and never returns."""


def open_window(design: str | os.PathLike[str]) -> None:
    """Show a design in a window; return when the window is closed.

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
        raise InputError(_message("there is no display"))
    path = Path(design).resolve()
    command = [sys.executable, "-P", "-c", CHILD, str(path), str(allowed_folder() or path.parent)]
    child = subprocess.run(command, check=False, capture_output=True, text=True)
    if child.returncode == NO_DISPLAY_STATUS:
        raise InputError(_message("the display does not answer"))
    if child.returncode != 0:
        lines = child.stderr.strip().splitlines()
        raise InputError(_message(f"the window could not be opened ({lines[-1] if lines else 'it crashed'})"))


def _message(reason: str) -> str:
    return f"{reason}; write a page for a browser instead with -o view.html"
