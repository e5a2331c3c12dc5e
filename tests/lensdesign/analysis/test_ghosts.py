"""Where a ghost falls, against ray-transfer matrices with two mirrors, which know of no negative index."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from lensdesign import load_design
from lensdesign.analysis.ghosts import ghost_first_order, ghost_report
from lensdesign.cli.commands import app
from lensdesign.errors import InputError

PAPER = load_design("designs/paper_singlet.toml")
N = float(PAPER.indices(0.532)[1])


def way(length):
    return np.array([[1.0, length], [0.0, 1.0]])


INTO = np.array([[1.0, 0.0], [(1.0 - N) / (N * 42.3), 1.0 / N]])
OUT = np.array([[1.0, 0.0], [(N - 1.0) / -12.0, N]])
# Both surfaces of a biconvex lens are concave to the light inside it.
MIRRORS = [np.array([[1.0, 0.0], [-2.0 / radius, 1.0]]) for radius in (12.0, 42.3)]
GHOST = OUT @ way(9.7) @ MIRRORS[1] @ way(9.7) @ MIRRORS[0] @ way(9.7) @ INTO
STRAIGHT = OUT @ way(9.7) @ INTO


def test_focal_lengths() -> None:
    found = ghost_first_order(PAPER)
    assert found.efl_mm == pytest.approx(-1.0 / GHOST[1, 0], rel=1e-12)
    assert found.bfl_mm == pytest.approx(-GHOST[0, 0] / GHOST[1, 0], rel=1e-12)


def test_irradiance_and_fringes_on_the_axis() -> None:
    report = ghost_report(PAPER)
    assert report.fraction == pytest.approx(((N - 1.0) / (N + 1.0)) ** 4, rel=1e-12)
    for one, plane in ((report.on_planes[0], 2.0), (report.on_planes[2], 22.0)):
        ghost, straight = (way(plane) @ m @ way(13.5) for m in (GHOST, STRAIGHT))
        ratio = report.fraction * (straight[0, 1] / ghost[0, 1]) ** 2
        assert one.field_mm == 0.0
        assert one.relative_irradiance == pytest.approx(ratio, rel=1e-5)
        assert one.contrast == pytest.approx(2.0 * math.sqrt(ratio) / (1.0 + ratio), rel=1e-5)
        slope = ghost[1, 1] / ghost[0, 1] - straight[1, 1] / straight[0, 1]
        limit = 0.532e-3 / 6.4e-3 / slope
        assert one.fringes_to_mm == pytest.approx(limit, rel=0.02)
        assert one.fringes_from_mm == pytest.approx(-one.fringes_to_mm, abs=0.05)
        assert -one.from_mm == pytest.approx(one.to_mm)


def test_the_share_of_a_coating_scales_irradiance() -> None:
    bare, coated = (ghost_report(PAPER, share).on_planes[1] for share in (1e-2, 1e-6))
    assert bare.relative_irradiance == pytest.approx(1e4 * coated.relative_irradiance)
    assert bare.contrast == pytest.approx(1e2 * coated.contrast, rel=0.01)
    with pytest.raises(InputError, match=r"fraction of the ghost = 1\.5.*0 to 1"):
        ghost_report(PAPER, 1.5)


def test_a_ghost_that_comes_to_a_focus_on_a_plane_is_brighter_than_the_light_beside_it() -> None:
    """As of a pair of catalogue lenses: no fringes have a contrast above 1."""
    near = ghost_report(load_design("designs/stock_pair.toml")).on_planes[0]
    assert near.relative_irradiance > 1.0
    assert 0.5 < near.contrast <= 1.0


def test_command() -> None:
    shown = CliRunner().invoke(app, ["ghost", "designs/paper_singlet.toml"])
    assert shown.exit_code == 0, shown.output
    assert "effective and back focal length of the ghost 8.609, -16.52 mm" in shown.stdout
    rows = [line.split() for line in shown.stdout.splitlines()[-4:]]
    assert [row[:2] for row in rows] == [["2", "0"], ["2", "1.5"], ["22", "0"], ["22", "1.5"]]
    outcome = CliRunner().invoke(app, ["ghost", "designs/paper_singlet.toml", "--share", "1e-4", "--json"])
    assert json.loads(outcome.stdout)["share"] == 1e-4
