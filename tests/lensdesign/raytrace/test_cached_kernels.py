"""Kept kernels go when something that they were compiled from has changed."""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import pytest
from numba.core import caching

from lensdesign.lens.shapes.compiled import SOURCES
from lensdesign.lens.shapes.registry import formula_classes
from lensdesign.raytrace.cached_kernels import KernelCacheWarning, _private_folder, cached_njit, drop_outdated


@pytest.fixture
def formula(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A module with a formula, which is imported."""
    path = tmp_path / "some_formula.py"
    path.write_text("def sag(r):\n    return r * r\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("some_formula")
    yield path
    sys.modules.pop("some_formula")


def kernel_in(folder: Path) -> Any:
    """What Numba says of a kernel."""
    return SimpleNamespace(__module__="room.kernel", stats=SimpleNamespace(cache_path=str(folder)))


def test_kernels_stay_while_their_sources_do(formula: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    drop_outdated(kernel_in(kept), ["some_formula"])
    for name in ("kernel.trace-1.py311.nbi", "other_kernel.trace-1.py311.nbi", "kernel.trace-1.py311.1.nbc"):
        (kept / name).touch()
    drop_outdated(kernel_in(kept), ["some_formula"])
    assert (kept / "kernel.trace-1.py311.nbi").exists()
    formula.write_text("def sag(r):\n    return 2 * r\n", encoding="utf-8")
    drop_outdated(kernel_in(kept), ["some_formula"])
    assert not (kept / "kernel.trace-1.py311.nbi").exists()
    assert (kept / "other_kernel.trace-1.py311.nbi").exists()


def test_nothing_is_touched_where_nothing_is_kept(formula: Path, tmp_path: Path) -> None:
    drop_outdated(lambda: None, ["some_formula"])
    drop_outdated(SimpleNamespace(stats=SimpleNamespace(cache_path=None)), ["some_formula"])
    (tmp_path / "file").touch()
    before = {path.name for path in tmp_path.iterdir()}
    drop_outdated(kernel_in(tmp_path / "file" / "kept"), ["some_formula"])
    assert {path.name for path in tmp_path.iterdir()} == before


def test_kernels_of_rays_are_kept_with_the_formulas_of_all_shapes() -> None:
    assert {shape.__module__ for shape in formula_classes()} < SOURCES
    assert all(name in sys.modules for name in SOURCES)


def test_processes_that_compile_at_the_same_time_do_not_mix_their_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    one, other = (cached_njit(nogil=True)(double)._cache._cache_file for _ in range(2))
    one.save("first", "code of the first arguments")
    # Another process reads the index before this one writes it, and stores its code before this one does.
    read, save_index = other._load_index(), one._save_index

    def interrupted(overloads: dict[str, str]) -> None:
        save_index(overloads)
        other.save("floats", "code of floats")

    with monkeypatch.context() as patched:
        patched.setattr(other, "_load_index", lambda: dict(read))
        patched.setattr(one, "_save_index", interrupted)
        one.save("integers", "code of integers")
    for cache in (one, other):
        assert cache.load("first") == "code of the first arguments"
        assert cache.load("floats") == "code of floats"
        assert cache.load("integers") in (None, "code of integers")


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Neither the modules' folders nor a home can be written: Numba uses the folder that it is given."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [caching.UserProvidedCacheLocator])
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    _private_folder.cache_clear()
    yield
    _private_folder.cache_clear()


def test_without_a_place_kernels_are_kept_in_a_private_temporary_folder(
    nowhere: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.warns(
        KernelCacheWarning, match=r"are cached in .*transferlens-kernels-.*NUMBA_CACHE_DIR"
    ) as caught:
        kernels = [cached_njit(nogil=True)(double) for _ in range(2)]
    assert len(caught) == 1
    assert kernels[0](3) == 6
    (place,) = tmp_path.iterdir()
    assert place.stat().st_mode & 0o777 == 0o700
    assert list(place.rglob("*.nbi"))
    assert os.environ["NUMBA_CACHE_DIR"] == str(place)


@pytest.mark.parametrize("fault", ["others can write", "a link", "no folder"])
def test_a_place_that_others_could_have_filled_is_not_taken(
    nowhere: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    place = tmp_path / f"transferlens-kernels-{os.getuid()}"
    if fault == "others can write":
        place.mkdir()
        place.chmod(0o777)
    elif fault == "a link":
        (tmp_path / "elsewhere").mkdir()
        place.symlink_to(tmp_path / "elsewhere")
    else:
        place.touch()
    with pytest.warns(KernelCacheWarning, match="are not cached: every process compiles its own"):
        kernel = cached_njit(nogil=True)(double)
    assert kernel(3) == 6
    assert not list(tmp_path.rglob("*.nbi"))
    assert "NUMBA_CACHE_DIR" not in os.environ


def double(value: int) -> int:
    """To be compiled."""
    return 2 * value
