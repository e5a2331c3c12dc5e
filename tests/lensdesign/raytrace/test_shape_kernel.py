"""Passages of blocks of rays through shapes that are not conics, as they are compiled and cached."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from places import ROOT

from lensdesign.lens.shapes.registry import FORMULAS, needed_formulas
from lensdesign.raytrace.shape_kernel import _dispatched, _passages

TRACED = """
import itertools, sys
import numpy as np
from numba.core.bytecode import FunctionIdentity
from lensdesign import Surface, load_design, trace

FunctionIdentity._unique_ids = itertools.count(100_000)
lens = load_design("designs/paper_singlet.toml")
backs = {
    "even asphere": Surface(radius_mm=-9.0, asphere=(1e-5,)),
    "toroid": Surface(shape="toroid", radius_mm=-9.0, radius_x_mm=-11.0),
    "Qbfs": Surface(shape="Qbfs", radius_mm=-9.0, normalization_radius_mm=8.5, q_mm=(0.01,)),
}
y = np.linspace(-3.0, 3.0, 7)
origins, directions = np.column_stack([0.5 * y, y, np.full(7, -13.5)]), np.tile([0.0, 0.0, 1.0], (7, 1))
for name in sys.argv[1:]:
    changed = lens.replaced(surfaces=(lens.surfaces[0], backs[name]))
    hits = trace(changed, origins, directions, 0.532, clip=False, record_hits=True).hits[:, 1]
    x, y, z = (hits - [0.0, 0.0, changed.vertex_z_mm[1]]).T
    assert np.allclose(z, backs[name].shape.sag(x, y), rtol=0.0, atol=1e-11), f"wrong {name}"
"""


def test_cached_kernels_of_several_processes_do_not_call_the_passages_of_each_other(tmp_path: Path) -> None:
    """Two processes give the same number to the passages of different shapes; a third one loads both."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    for names in (["even asphere"], ["toroid"], ["Qbfs"], ["toroid", "Qbfs"]):
        done = subprocess.run(
            [sys.executable, "-c", TRACED, *names],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr


def test_every_passage_has_a_name_of_its_own() -> None:
    names = []
    for terms in (2, 8, 12):
        every = needed_formulas(bytes(range(len(FORMULAS))), terms)
        passages = _passages(tuple(map(len, every)))
        names += [passage.py_func.__qualname__ for _, passage in passages]
        chosen = {_dispatched(passages[i:]).py_func.__qualname__ for i in range(len(passages))}
        assert len(chosen) == len(passages)
    unrolled = sum(len(counts) for counts in FORMULAS.values())
    assert len(set(names)) == unrolled
