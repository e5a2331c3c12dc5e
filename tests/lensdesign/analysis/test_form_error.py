"""PV and RMS of figures against closed forms, and where commands and pictures show them."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from lensdesign import Lens, save_design
from lensdesign.analysis.check import check_design
from lensdesign.analysis.form_error import Removed, form_errors, pv_rms_waves
from lensdesign.cli.commands import app
from lensdesign.errors import InputError
from lensdesign.lens.surface_figure import surface_figure_from_grid, surface_figure_from_zernike
from lensdesign.manufacture.mesh.mesh import write_mesh
from lensdesign.plots.plots import draw_all
from lensdesign.plots.surface_figures import surface_figure_map

WAVE_UM = 0.6328
SEMI_MM = 8.26

# Peak-to-valley of each polynomial over the disc, by hand.
PV = {
    3: 2.0 * math.sqrt(6.0),
    5: 2.0 * math.sqrt(6.0),
    9: 2.0 * math.sqrt(8.0),
    7: 2.0 * math.sqrt(8.0),
    4: 2.0 * math.sqrt(3.0),
    12: 1.5 * math.sqrt(5.0),
}


def measured(lens: Lens) -> Lens:
    """The paper's lens with a figure on either surface."""
    front = {"semi_diameter_mm": SEMI_MM, "zernike_waves_633nm": {5: 0.279 / PV[5]}}
    back = {"semi_diameter_mm": 10.0, "zernike_waves_633nm": {9: 0.427 / PV[9], 1: 0.3, 4: 0.1}}
    return lens.with_surface(0, figure=front).with_surface(1, figure=back)


@pytest.mark.parametrize("index", PV)
def test_pv_and_rms_of_one_polynomial(index: int) -> None:
    figure = surface_figure_from_zernike({index: 0.1 * WAVE_UM}, SEMI_MM)
    pv, rms = pv_rms_waves(figure, SEMI_MM)
    assert pv == pytest.approx(0.1 * PV[index], rel=2e-3)
    assert rms == pytest.approx(0.1, rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1))
def test_rms_is_the_root_of_the_sum_of_squares(seed: int) -> None:
    values = np.random.default_rng(seed).normal(0.0, 0.1, 15)
    figure = surface_figure_from_zernike(dict(enumerate(WAVE_UM * values)), SEMI_MM)
    removed: dict[Removed, list[int]] = {"piston": [0], "tilt": [0, 1, 2], "power": [0, 1, 2, 4]}
    for name, indices in removed.items():
        right = np.sqrt(np.sum(np.delete(values, indices) ** 2))
        assert pv_rms_waves(figure, SEMI_MM, name)[1] == pytest.approx(right, rel=1e-5)


def test_only_the_clear_aperture_counts() -> None:
    at = np.linspace(-10.0, 10.0, 201)
    bump = 1e-3 * WAVE_UM * np.exp(-(((at - 9.5) / 0.3) ** 2 + (at[:, None] / 0.3) ** 2))
    figure = surface_figure_from_grid(bump, 0.1, 10.0)
    assert pv_rms_waves(figure, 8.0)[0] < 1e-6
    assert pv_rms_waves(figure, 10.0)[0] == pytest.approx(1.0, abs=0.02)


def test_the_papers_surfaces(paper_lens: Lens) -> None:
    assert form_errors(paper_lens) == ()
    front, back = form_errors(measured(paper_lens))
    assert (front.surface, back.surface, front.wavelength_um) == (1, 2, WAVE_UM)
    assert front.pv_waves == pytest.approx(0.279, rel=1e-3)
    assert back.pv_without_power_waves == pytest.approx(0.427, rel=1e-3)
    assert back.rms_waves == pytest.approx(math.hypot(0.1, 0.427 / PV[9]), rel=1e-5)


def test_the_check_shows_figures(paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, runner, report = tmp_path / "lens.toml", CliRunner(), check_design(measured(paper_lens))
    save_design(measured(paper_lens), path)
    assert report.figures == form_errors(measured(paper_lens))
    monkeypatch.setattr("lensdesign.analysis.check.check_design", lambda lens: report)
    shown = runner.invoke(app, ["check", str(path)]).stdout
    assert "surface 1 as measured: PV 0.279, RMS 0.057 waves at 632.8 nm without tilt" in shown
    held = json.loads(runner.invoke(app, ["check", str(path), "--json"]).stdout)
    assert [f["surface"] for f in held["figures"]] == [1, 2]
    assert held["figures"][1]["pv_without_power_waves"] == pytest.approx(0.427, rel=1e-3)


def test_a_mesh_says_that_it_leaves_figures_out(paper_lens: Lens, tmp_path: Path) -> None:
    path, mesh = tmp_path / "lens.toml", tmp_path / "lens.stl"
    save_design(measured(paper_lens), path)
    done = CliRunner().invoke(app, ["export", str(path), str(mesh), "--chord-error-um", "20", "--json"])
    assert done.exit_code == 0
    assert json.loads(done.stdout)["surfaces_without_their_figure"] == [1, 2]
    assert "surface 2: the nominal shape was written" in done.stderr
    with pytest.warns(UserWarning, match=r"surface 1: .*measured figure"):
        write_mesh(paper_lens.with_surface(0, figure=measured(paper_lens).surfaces[0].figure), mesh, 20.0)


def test_a_map_shows_the_error_without_tilt(paper_lens: Lens) -> None:
    picture = surface_figure_map(measured(paper_lens), 1)
    axes, bar = picture.axes
    assert axes.get_title() == r"Surface 2: PV 0.560 $\lambda$, RMS 0.125 $\lambda$"
    assert "632.8 nm" in bar.get_ylabel()
    (image,) = axes.images
    shown = np.ma.filled(image.get_array(), np.nan)
    at = np.linspace(-1.0, 1.0, len(shown))
    rho, theta = np.hypot(at, at[:, None]), np.arctan2(at[:, None], at)
    right = 0.427 / PV[9] * math.sqrt(8.0) * rho**3 * np.cos(3.0 * theta)
    right += 0.1 * math.sqrt(3.0) * (2.0 * rho**2 - 1.0)
    inside = rho <= 1.0
    assert np.all(np.isnan(shown[~inside]))
    assert shown[inside] == pytest.approx(right[inside], abs=2e-3)


def test_a_map_is_drawn_of_every_measured_surface(
    paper_lens: Lens, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lens = measured(paper_lens).with_surface(0, figure=None)
    for name in ("layout_figure", "spot_figure", "incidence_figure", "spread_figure"):
        monkeypatch.setattr(f"lensdesign.plots.plots.{name}", lambda lens: surface_figure_map(lens, 1))
    monkeypatch.setattr("lensdesign.plots.plots.render_lens", lambda lens, path: None)
    names = [path.name for path in draw_all(lens, tmp_path)]
    charts = ["layout.png", "spots.png", "incidence.png", "spread.png"]
    assert names == [*charts, "surface_2_figure.png", "view3d.png"]
    assert (tmp_path / "surface_2_figure.png").read_bytes() == (tmp_path / "layout.png").read_bytes()


def test_no_map_of_a_surface_without_a_figure(paper_lens: Lens) -> None:
    with pytest.raises(InputError, match=r"surface 1.*figure"):
        surface_figure_map(paper_lens, 0)
