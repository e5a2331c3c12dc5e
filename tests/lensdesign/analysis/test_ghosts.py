"""Where a ghost falls, against ray-transfer matrices with two mirrors, which know of no negative index."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lensdesign import Coating, CoatingLayer, load_design, save_design
from lensdesign.analysis import ghost_paths
from lensdesign.analysis.ghosts import ghost_first_order, ghost_report, uncoated_ghost_fraction
from lensdesign.cli.commands import app
from lensdesign.errors import DesignError, InputError

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


def coated(lens, *coatings):
    surfaces = (s.replaced(coating=c) for s, c in zip(lens.surfaces, coatings, strict=True))
    return lens.replaced(surfaces=tuple(surfaces))


def test_the_fraction_is_that_of_the_coatings_at_normal_incidence() -> None:
    film_index = 1.38
    quarter_wave = Coating(layers=(CoatingLayer(index=film_index, thickness_nm=532.0 / (4.0 * film_index)),))
    bare, film = ((N - 1.0) / (N + 1.0)) ** 2, ((N - film_index**2) / (N + film_index**2)) ** 2
    assert ghost_report(PAPER).fraction == pytest.approx(bare**2, rel=1e-12)
    assert ghost_report(coated(PAPER, "bare", "bare")).fraction == pytest.approx(bare**2, rel=1e-12)
    assert ghost_report(coated(PAPER, quarter_wave, "bare")).fraction == pytest.approx(bare * film, rel=1e-9)
    assert ghost_report(coated(PAPER, "bare", "ideal")).fraction == 0.0
    assert uncoated_ghost_fraction(coated(PAPER, "bare", "ideal")) == pytest.approx(bare**2, rel=1e-12)


def test_a_ghost_that_comes_to_a_focus_on_a_plane_is_brighter_than_the_light_beside_it() -> None:
    """As of a pair of catalogue lenses: no fringes have a contrast above 1."""
    near = ghost_report(load_design("designs/stock_pair.toml")).on_planes[0]
    assert near.relative_irradiance > 1.0
    assert 0.5 < near.contrast <= 1.0


def run(*arguments) -> str:
    outcome = CliRunner().invoke(app, ["ghost", *map(str, arguments)])
    assert outcome.exit_code == 0, outcome.output
    return outcome.stdout


def test_command() -> None:
    shown = run("designs/paper_singlet.toml")
    assert "fraction of the light at normal incidence 0.00181" in shown
    assert "effective and back focal length of the ghost 8.609, -16.52 mm" in shown
    rows = [line.split() for line in shown.splitlines()[-4:]]
    assert [row[:2] for row in rows] == [["2", "0"], ["2", "1.5"], ["22", "0"], ["22", "1.5"]]
    assert "all coatings of the design are ideal" in shown
    assert "add reflectance = 0.05" in shown
    found = ghost_paths(PAPER)
    assert f"all ghosts on the sensor: {found.total(2.0):.3g} at 2 mm, {found.total(22.0):.3g} at 22" in shown
    values = json.loads(run("designs/paper_singlet.toml", "--share", "1e-4", "--json"))
    assert values["share"] == 1e-4
    assert {"efl_mm", "bfl_mm", "on_planes"} < values.keys()
    assert values["ghost_paths"] == found.as_dict()


def test_command_of_a_design_with_coatings_cover_glass_and_a_reflectance(tmp_path) -> None:
    text = (
        "reflectance = 0.05\n"
        '[sensor.cover_glass]\nthickness_mm = 0.7\nmaterial = "N-BK7"\ndistance_mm = 0.5\ncoating = "bare"\n'
    )
    path = tmp_path / "lens.toml"
    path.write_text(
        Path("designs/paper_singlet.toml").read_text().replace("\n\n[[surface]]", f"\n{text}\n[[surface]]", 1)
    )
    shown = run(path)
    assert "all coatings of the design are ideal" not in shown
    assert "missing" not in shown
    assert "warning" not in shown
    assert "cover glass rear  cover glass front" in shown
    assert "surface 1" not in shown
    assert "via surfaces with an ideal coating, are not listed" in shown
    lens = load_design(path)
    assert (lens.sensor.reflectance, lens.sensor.cover_glass.coating) == (0.05, "bare")
    save_design(coated(lens, "bare", "bare"), path)
    assert load_design(path) == coated(lens, "bare", "bare")
    shown = run(path)
    row = next(line for line in shown.splitlines() if "cover glass front  surface 1" in line)
    assert row.split()[5:9] == ["1", "0.0013", "0.0013", "0.056"]
    assert "warning: the ghost cover glass front - surface 1 is focused" in shown


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("reflectance = 1.0", "sensor, reflectance = 1.0: must be less than 1"),
        ("reflectance = -0.1", "sensor, reflectance = -0.1: must be greater than or equal to 0"),
        (
            '[sensor.cover_glass]\nthickness_mm = 0.7\nmaterial = 1.5\ndistance_mm = 0.5\ncoating = "shiny"',
            "sensor, cover_glass, coating = 'shiny': must be 'ideal', 'bare' or 'mgf2'",
        ),
    ],
)
def test_impossible_reflections_are_refused(tmp_path, keys, message) -> None:
    path = tmp_path / "lens.toml"
    text = Path("designs/paper_singlet.toml").read_text()
    path.write_text(text.replace("\n\n[[surface]]", f"\n{keys}\n\n[[surface]]", 1))
    with pytest.raises(DesignError, match=re.escape(f"lens.toml: {message}")):
        load_design(path)
