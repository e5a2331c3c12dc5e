"""Measured figures in files: grids and design files read back, and every fault named."""

from __future__ import annotations

import math
import os
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT

from lensdesign import DesignError, InputError, Lens, load_design, save_design, scaled
from lensdesign.common.input_files import files_from
from lensdesign.files.surface_figures import (
    read_surface_figure_grid,
    surface_figure,
    write_surface_figure_grid,
)
from lensdesign.lens.height_maps import implausible_heights
from lensdesign.lens.surface_figure import surface_figure_from_zernike
from lensdesign.optimization.specification.specification import load_specification
from lensdesign.raytrace.compiled import compile_system
from lensdesign.raytrace.gradients import gradient_traces

SEEDS = st.integers(0, 2**32 - 1)

DESIGN = """
wavelengths_um = [0.532]

[object]
field_diameter_mm = 3.0
numerical_aperture = 0.25
working_distance_mm = 13.5

[sensor]
pixel_pitch_um = 3.2
pixels = [9344, 7000]
plane_distances_mm = [2.0, 22.0]

[[surface]]
radius_mm = 42.3
thickness_mm = 9.7
material = "N-BK7"
semi_diameter_mm = 4.0
stop = true

[surface.figure]
FIGURE

[[surface]]
radius_mm = -12.0
conic = -0.9
semi_diameter_mm = 6.0
"""

ZERNIKE = "zernike_um = { 4 = 0.05, 7 = -0.02 }\nsemi_diameter_mm = 4.5"


def design(folder: Path, figure: str) -> Path:
    """A design file whose first surface has this figure table."""
    path = folder / "lens.toml"
    path.write_text(DESIGN.replace("FIGURE", figure))
    return path


def grid_file(folder: Path, name: str = "front.csv") -> Path:
    """A grid file of a tilted, bent map."""
    at = np.linspace(-5.0, 5.0, 51)
    path = folder / name
    write_surface_figure_grid(1e-4 * (at[:, None] + at**2), 0.2, path)
    return path


# Grid files.


@given(seed=SEEDS)
def test_a_written_grid_reads_back(tmp_path_factory: pytest.TempPathFactory, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.uniform(-1.0, 1.0, rng.integers(1, 12, 2)) * 10.0 ** rng.integers(-9, 1)
    values[rng.random(values.shape) < 0.2] = np.nan
    spacing = float(rng.uniform(0.01, 1.0))
    path = tmp_path_factory.getbasetemp() / "map.csv"
    write_surface_figure_grid(values, spacing, path)
    read, read_spacing = read_surface_figure_grid(path)
    assert read_spacing == spacing
    np.testing.assert_allclose(read, values, rtol=1e-15)


def test_rows_rise_along_y_and_values_along_x(tmp_path: Path) -> None:
    figure = surface_figure(load_design(design(tmp_path, f'file = "{grid_file(tmp_path).name}"')).surfaces[0])
    assert figure is not None
    assert figure.sag(0.0, 3.0) == pytest.approx(3e-4, abs=1e-12)
    assert figure.sag(3.0, 0.0) == pytest.approx(9e-4, abs=1e-12)


@pytest.mark.parametrize(
    ("unit", "value_mm"), [("mm", 0.5), ("um", 5e-4), ("nm", 5e-7), ("waves_633nm", 0.5 * 0.6328e-3)]
)
def test_units_comments_and_points_not_measured(tmp_path: Path, unit: str, value_mm: float) -> None:
    path = tmp_path / "map.csv"
    path.write_text(
        f"\ufeff# of the first sample\n# unit = {unit}\n#spacing_mm=0.5\n0.5, ,nan\n\n1.25e-1,.25,-.5\n"
    )
    values, spacing = read_surface_figure_grid(path)
    assert spacing == 0.5
    np.testing.assert_allclose(
        values, value_mm * np.array([[1.0, np.nan, np.nan], [0.25, 0.5, -1.0]]), rtol=1e-14
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# unit = um\n1,2\n", "no line '# spacing_mm"),
        ("# spacing_mm = 1\n1,2\n", "no line '# unit"),
        ("# spacing_mm = 1\n# unit = um\n", "holds no values"),
        ("# spacing_mm = 1\n# unit = um\n1,2\n1,2,3\n", r"line 4: 3 values.* 2"),
        ("# spacing_mm = 1\n# unit = um\n1,x\n", "line 3: 'x' is not a number"),
        ("# spacing_mm = 1\n# unit = um\n0,1,0,2\n0,3,-1,4\n", "line 3: '0,1,0,2': may be 4 whole numbers"),
        ("# spacing_mm = 1\n# unit = um\n0,15;0,2\n", "line 3: '15;0' is not a number"),
        ("# spacing_mm = 1\n# unit = um\n0,012,1\n", "line 3: '012': begins with a zero"),
        ("# spacing_mm = 0,1\n# unit = um\n1.5,2\n", "line 1: spacing_mm = '0,1' is not a number: a comma"),
        ("# spacing_mm = 1\n# unit = um\n1,inf\n", "line 3: inf is not a valid sag error"),
        ("# spacing_mm = -1\n# unit = um\n1\n", "line 1: spacing_mm = -1: must be 1e-05 to 1000 mm"),
        ("# spacing_mm = 1\n# unit = mils\n1\n", "line 2: unit = mils: allowed: mm, um, nm, waves_633nm"),
        ("# spacing = 1\n1\n", r"line 1: spacing: .*did you mean spacing_mm"),
        ("# unit = um\n# unit = um\n1\n", "line 2: unit is given twice"),
    ],
)
def test_faults_of_a_grid_file_are_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_surface_figure_grid(path)
    assert str(path) in str(caught.value)


def heights_nm() -> Any:
    """A bowl of 80 nm on 21 x 21 points."""
    at = np.linspace(-1.0, 1.0, 21)
    return np.round(40.0 * (at[:, None] ** 2 + at**2), 2)


def write_nm(path: Path, values_nm: Any, header: str = "") -> Path:
    lines = [",".join(f"{value:g}" for value in row) for row in values_nm]
    path.write_text("\n".join([f"# spacing_mm = 0.5\n# unit = nm{header}", *lines]) + "\n")
    return path


@pytest.mark.parametrize("fill", [-9999.0, 9999.0, -32768.0, 999.99, 1e4, -1e38])
@pytest.mark.parametrize("where", ["one", "outside", "both signs"])
def test_fill_values_are_not_taken_as_heights(tmp_path: Path, fill: float, where: str) -> None:
    values, at = heights_nm(), np.linspace(-1.0, 1.0, 21)
    filled = np.hypot(at[:, None], at) > 0.8 if where == "outside" else np.zeros(values.shape, bool)
    filled[7, 11] = where != "outside"
    values[filled] = fill
    if where == "both signs":
        values[3, 3] = -fill
    path = write_nm(tmp_path / "map.csv", values)
    with pytest.raises(InputError, match=r"nm lies far from all other heights.*# no_data = ") as caught:
        read_surface_figure_grid(path)
    assert str(path) in str(caught.value)
    if where != "both signs":
        read, _ = read_surface_figure_grid(write_nm(path, values, f"\n# no_data = {fill:g}"))
        np.testing.assert_array_equal(np.isnan(read), filled)
        np.testing.assert_allclose(read[~filled], 1e-6 * heights_nm()[~filled], rtol=1e-12, atol=1e-18)


def test_a_height_far_from_the_others_may_be_stated_to_be_one(tmp_path: Path) -> None:
    values = heights_nm()
    values[4, 4] = 3000.0
    read, _ = read_surface_figure_grid(write_nm(tmp_path / "map.csv", values, "\n# no_data = none"))
    assert read[4, 4] == pytest.approx(3e-3)
    write_surface_figure_grid(read, 0.5, tmp_path / "again.csv")
    np.testing.assert_allclose(read_surface_figure_grid(tmp_path / "again.csv")[0], read, rtol=1e-15)


@given(seed=SEEDS)
def test_real_maps_have_no_implausible_heights(seed: int) -> None:
    """Bowls, bumps, steps and rough surfaces, also with points without data."""
    rng = np.random.default_rng(seed)
    at = np.linspace(-1.0, 1.0, 40)
    x, y = np.meshgrid(at, at)
    bowl = rng.normal() * (x * x + y * y) + rng.normal() * x * y
    bump = 20.0 * rng.normal() * np.exp(-((x - 0.3) ** 2 + (y + 0.2) ** 2) / 0.02)
    height = bowl + bump + rng.normal() * (x > rng.uniform(-0.8, 0.8)) + 0.1 * rng.normal(size=x.shape)
    height[rng.random(height.shape) < 0.3] = np.nan
    assert not np.any(implausible_heights(height * 10.0 ** rng.uniform(-6, -1)))


@pytest.mark.parametrize("height_mm", [1e4, -1e4, 1.01])
def test_a_map_of_heights_that_no_surface_has_is_refused(tmp_path: Path, height_mm: float) -> None:
    path = write_nm(tmp_path / "map.csv", np.full((9, 9), 1e6 * height_mm))
    with pytest.raises(InputError, match=r"a height of .* must be at most 1 mm; check the unit"):
        read_surface_figure_grid(path)


def test_what_is_no_grid_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"shape \(3,\)"):
        write_surface_figure_grid(np.zeros(3), 1.0, tmp_path / "map.csv")
    assert not list(tmp_path.iterdir())


# Design files.


@pytest.mark.parametrize("figure", [ZERNIKE, ZERNIKE.replace("_um", "_waves_633nm"), 'file = "front.csv"'])
def test_a_saved_design_reads_back_equal_from_anywhere(tmp_path: Path, figure: str) -> None:
    grid_file(tmp_path)
    lens = load_design(design(tmp_path, figure))
    for folder in (tmp_path, tmp_path / "else" / "where"):
        save_design(lens, folder / "copy.toml")
        with files_from(tmp_path):
            again = load_design(folder / "copy.toml")
        assert again == lens
        own, other = (surface_figure(one.surfaces[0]) for one in (lens, again))
        assert own is other
    if "file" in figure:
        assert 'file = "../../front.csv"' in (tmp_path / "else" / "where" / "copy.toml").read_text()


def test_coefficients_in_waves_are_those_of_the_helium_neon_laser(tmp_path: Path) -> None:
    table = "zernike_waves_633nm = { 7 = 0.5 }\nsemi_diameter_mm = 4.5"
    figure = surface_figure(load_design(design(tmp_path, table)).surfaces[0])
    assert figure is not None
    assert figure.sag(1.0, 2.0) == pytest.approx(surface_figure_from_zernike({7: 0.3164}, 4.5).sag(1.0, 2.0))


def test_a_changed_file_is_read_again(tmp_path: Path) -> None:
    lens = load_design(design(tmp_path, f'file = "{grid_file(tmp_path).name}"'))
    before = compile_system(lens, 0.532).sag(0, np.zeros(1), np.ones(1))
    write_surface_figure_grid(np.full((60, 60), 0.1), 0.2, tmp_path / "front.csv")
    after = compile_system(lens, 0.532).sag(0, np.zeros(1), np.ones(1))
    assert after - before == pytest.approx(0.1 - 1e-4)


@pytest.mark.parametrize(
    ("figure", "message"),
    [
        ("", r"surface 1, figure: .*file, zernike_um, zernike_waves_633nm"),
        ('file = "front.csv"\nzernike_um = { 4 = 1.0 }', "file and zernike_um"),
        ("zernike_um = { 4 = 0.1 }", "zernike_um needs a semi_diameter_mm"),
        ('file = "front.csv"\nsemi_diameter_mm = 5.0', "semi_diameter_mm goes with Zernike coefficients"),
        ("zernike_um = { 4 = 0.1 }\nsemi_diameter_mm = 3.9", r"3.9 .* 4"),
        ("zernike = { 4 = 0.1 }", r"figure, zernike: .*did you mean zernike_um"),
        ("zernike_um = { 999 = 0.1 }\nsemi_diameter_mm = 5.0", "Zernike index 999: must be a whole number"),
        ("zernike_um = { coma = 0.1 }\nsemi_diameter_mm = 5.0", "Zernike index 'coma'"),
        ("zernike_um = { 4 = inf }\nsemi_diameter_mm = 5.0", "coefficient 4 = inf"),
        ("zernike_um = [0.1]\nsemi_diameter_mm = 5.0", "zernike_um: must be a table"),
        ('file = "none.csv"', r"surface 1: cannot read .*none\.csv: No such file"),
        ("file = 3", "surface 1, figure, file = 3: must"),
        ('file = "small.csv"', r"surface 1: .*small\.csv: figure: the grid reaches 3 mm"),
        ('file = "holes.csv"', r"surface 1: .*holes\.csv: figure: 2 of \d+ points inside"),
    ],
)
def test_faults_of_a_figure_table_are_named(tmp_path: Path, figure: str, message: str) -> None:
    grid_file(tmp_path)
    write_surface_figure_grid(np.zeros((31, 31)), 0.2, tmp_path / "small.csv")
    holes = np.zeros((51, 51))
    holes[25, 25:27] = holes[0] = np.nan
    write_surface_figure_grid(holes, 0.2, tmp_path / "holes.csv")
    path = design(tmp_path, figure)
    with pytest.raises(InputError, match=message) as caught:
        load_design(path)
    assert str(caught.value).startswith(str(path))


def test_a_figure_needs_a_clear_aperture(paper_lens: Lens) -> None:
    figure = {"semi_diameter_mm": 20.0, "zernike_um": {4: 0.1}}
    with pytest.raises(DesignError, match=r"figure.*semi_diameter_mm"):
        paper_lens.with_surface(1, semi_diameter_mm=None, figure=figure)


def test_tables_that_the_documentation_shows_are_valid(tmp_path: Path) -> None:
    grid_file(tmp_path, "front_figure.csv")
    page = (ROOT / "docs" / "design-files.md").read_text(encoding="utf-8")
    tables = re.findall(r"^    \[surface\.figure\]\n((?:    .+\n)+)", page, re.MULTILINE)
    assert len(tables) == 2
    for table in tables:
        assert surface_figure(load_design(design(tmp_path, textwrap.dedent(table))).surfaces[0]) is not None


# Who else has to know.


def test_zernike_figures_scale_with_the_lens(tmp_path: Path) -> None:
    lens = load_design(design(tmp_path, ZERNIKE))
    own, small = (surface_figure(one.surfaces[0]) for one in (lens, scaled(lens, 0.125)))
    assert own is not None
    assert small is not None
    assert small.sag(0.125, 0.25) == pytest.approx(0.125 * float(own.sag(1.0, 2.0)), rel=1e-12)
    assert abs(float(own.sag(1.0, 2.0))) > 1e-6


def test_a_grid_file_does_not_scale(tmp_path: Path) -> None:
    lens = load_design(design(tmp_path, f'file = "{grid_file(tmp_path).name}"'))
    with pytest.raises(DesignError, match=r"front\.csv cannot be scaled; give it as Zernike coefficients"):
        scaled(lens, 0.5)


def test_specifications_and_derivatives_refuse_figures(tmp_path: Path) -> None:
    path = design(tmp_path, ZERNIKE)
    lens = load_design(path)
    with path.open("a") as file:
        file.write('[[variable]]\nsurface = 2\nparameter = "conic"\nbounds = [-2.0, 0.0]\n')
    with pytest.raises(DesignError, match=r"surface 1: .*figure"):
        load_specification(path)
    with pytest.raises(InputError, match="remove the measured figures"):
        gradient_traces(
            compile_system(lens, 0.532), -13.5, np.array([2.0]), 0, 4.0, 0.25, *np.zeros((2, 1, 2)), ()
        )[0]


def test_zernike_figures_need_no_file(tmp_path: Path) -> None:
    lens = load_design(design(tmp_path, ZERNIKE))
    os.remove(tmp_path / "lens.toml")
    x = np.array([2.0])
    added = compile_system(lens, 0.532).sag(0, x, x) - lens.surfaces[0].sag_mm(math.sqrt(8.0))
    assert added == pytest.approx(surface_figure_from_zernike({4: 0.05, 7: -0.02}, 4.5).sag(x, x), rel=1e-9)
