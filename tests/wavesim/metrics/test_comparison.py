"""Engines side by side, and where they fail."""

import csv
import json
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lensdesign import load_design, save_design, scaled
from wavesim.analytic.registry import analytic_case
from wavesim.cli.commands import main
from wavesim.engines.registry import ENGINES
from wavesim.fields.field import Grid
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics import comparison, failures
from wavesim.metrics.comparison import (
    Measured,
    Variant,
    compare,
    lens_case,
    random_field,
    variants,
    with_front,
)
from wavesim.metrics.failures import (
    REFUSED,
    SILENT,
    WARNED,
    FailureMap,
    free_space_maps,
    map_rows,
    slice_maps,
    step_maps,
    tile_map,
)
from wavesim.plots.comparisons import comparison_figure, failure_figure
from wavesim.runtime.result_files import write_csv
from wavesim.scene.patches import patch_scene
from wavesim.scene.scene import Scene

TWIN = scaled(load_design("designs/paper_singlet.toml"), 1 / 16)


def row(error: float, seconds: float, peak_mb: float) -> Measured:
    return Measured("s", "f", "", error, seconds, 0.0, peak_mb, error, seconds, peak_mb, 1e-3)


def test_the_front_holds_what_nothing_beats() -> None:
    rows = with_front([row(0.1, 1.0, 9.0), row(0.2, 2.0, 1.0), row(0.05, 3.0, 9.0), row(np.nan, 0.1, 0.1)])
    assert [r.fastest for r in rows] == [True, False, True, False]
    assert [r.smallest for r in rows] == [False, True, True, False]


def test_speckle_fills_the_aperture_evenly() -> None:
    grid = Grid((512, 512), 2e-4, -1.0)
    field = random_field(grid, 0.5, 0.4)
    assert np.mean(np.abs(field.values) ** 2) == pytest.approx(1.0)
    spectrum = np.abs(np.fft.fft2(field.values)) ** 2
    radius = np.hypot(*np.meshgrid(*[np.fft.fftfreq(512, 2e-4)] * 2))
    inside = radius < 0.4 / 0.5e-3
    assert spectrum[~inside].max() < 1e-18 * spectrum.max()
    inner = radius < 0.5 * 0.4 / 0.5e-3
    assert spectrum[inner].mean() == pytest.approx(spectrum[inside].mean(), rel=0.05)


@pytest.mark.usefixtures("few_cells")
def test_measured_beside_predicted(tmp_path: Path) -> None:
    cases = {"cylinder": analytic_case("cylinder", radius_mm=0.05), "twin": lens_case(TWIN, 0.01)}
    settings = ({"error": 0.1, "quadratic": "low-rank"}, {"error": 3e-3, "quadratic": "low-rank"}, {})

    def tried(scene: Scene) -> list[Variant]:
        chosen = [v for v in variants(scene) if v[2] in settings and v[1] != "no-lens"]
        return chosen + [v for v in variants(scene) if v[0] == "wpm, substep"][:2]

    calls: list[tuple[int, int]] = []
    rows = compare(cases, tried, lambda done, total, _: calls.append((done, total)))
    assert calls == [(i, len(rows)) for i in range(len(rows))]
    assert {r.scene for r in rows} == set(cases)
    best = min((r for r in rows if r.scene == "cylinder"), key=lambda r: r.relative_error)
    assert best.relative_error < 5e-3
    assert best.fastest
    assert all(r.seconds > 0 for r in rows if np.isfinite(r.relative_error))
    assert all(r.message for r in rows if np.isnan(r.relative_error))
    write_csv([r.as_dict() for r in rows], tmp_path / "rows.csv")
    with (tmp_path / "rows.csv").open() as file:
        back = list(csv.DictReader(file))
    assert [float(b["relative_error"]) for b in back] == pytest.approx(
        [r.relative_error for r in rows], nan_ok=True
    )
    figure = comparison_figure(rows, "title")
    assert len(figure.axes) == 4
    figure.savefig(tmp_path / "rows.png")


def test_every_engine_is_compared() -> None:
    line, plane = (patch_scene(TWIN, 0.01, meridional=meridional) for meridional in (True, False))
    assert {engine for _, engine, _ in variants(plane)} == {*ENGINES, "hierarchical"}
    assert {engine for _, engine, _ in variants(line)} == set(ENGINES)


def assert_speaks_first(found: FailureMap, largest_silent: float) -> None:
    """Where the guard is silent the error is small; it does speak; worse cells are not reported as better."""
    assert set(np.unique(found.guard)) <= {SILENT, WARNED, REFUSED}
    silent = found.error[found.guard == SILENT]
    assert len(silent)
    assert np.all(silent < largest_silent)
    assert np.any(found.guard > SILENT)
    rows = map_rows(found)
    assert len(rows) == found.error.size


RANGES = (
    "APERTURES",
    "SLICES",
    "TILES_MM",
    "FIELD_SHARES",
    "STEPS_UM",
    "INCIDENCES_DEG",
    "DISTANCES_MM",
    "PITCHES_UM",
)
FEW_ZONES = 20.0


@pytest.fixture(scope="module")
def few_cells() -> Iterator[None]:
    """Of each range of settings both ends and the middle."""
    with pytest.MonkeyPatch.context() as patch:
        for name in RANGES:
            values = getattr(failures, name)
            patch.setattr(failures, name, (values[0], values[len(values) // 2], values[-1]))
        patch.setattr(comparison, "REFERENCE_ZONES", FEW_ZONES)
        yield


@pytest.fixture(scope="module")
def free_space(few_cells: None) -> list[FailureMap]:
    return list(free_space_maps())


@pytest.mark.usefixtures("few_cells")
@pytest.mark.filterwarnings("ignore::wavesim.fields.sampling_checks.SamplingWarning")
def test_slices_warn_before_they_fail() -> None:
    maps = {found.name: found for found in slice_maps(TWIN, 0.01)}
    assert_speaks_first(maps["slices_vertical"], 0.35)
    oblique = maps["slices_oblique"].error
    assert np.all(oblique <= maps["slices_vertical"].error)
    assert np.all(oblique[:, -1] < oblique[:, 0])


@pytest.mark.usefixtures("few_cells")
def test_tiles_warn_before_they_fail() -> None:
    found = tile_map(TWIN)
    assert_speaks_first(found, 0.4)
    assert np.any(found.guard == REFUSED)


@pytest.mark.usefixtures("few_cells")
def test_steps_warn_before_they_fail() -> None:
    substep, staircase = step_maps()
    assert_speaks_first(substep, 1e-2)
    assert np.any(substep.guard == REFUSED)
    assert np.all(staircase.guard >= WARNED)
    assert np.any(staircase.guard == REFUSED)


def test_free_space_warns_before_it_fails(free_space: list[FailureMap]) -> None:
    for found in free_space:
        assert_speaks_first(found, 2e-3)
        assert np.all(found.error[found.guard == WARNED] < 0.1)


def test_pictures_of_maps(tmp_path: Path, free_space: list[FailureMap]) -> None:
    figure = failure_figure(free_space, "title")
    assert len(figure.axes) == 3
    figure.savefig(tmp_path / "maps.png")


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    design, out = tmp_path / "twin.toml", tmp_path / "out"
    save_design(TWIN, design)
    small = [("eikonal", "eikonal", {"error": error}) for error in (0.1, 0.01)]
    monkeypatch.setattr("wavesim.metrics.comparison.variants", lambda scene: small)
    options = ["--patch-mm", "0.01", "--radius-mm", "0.05", "--no-planes", "--no-maps", "--json"]
    monkeypatch.setattr(sys, "argv", ["wavesim", "compare-engines", str(design), "-o", str(out), *options])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SamplingWarning)
        with pytest.raises(SystemExit) as stopped:
            main()
    assert not stopped.value.code
    found = json.loads(capsys.readouterr().out)
    assert len(found["measured"]) == 4
    assert (out / "comparison.png").stat().st_size > 10_000
    assert len((out / "comparison.csv").read_text().splitlines()) == 5


@pytest.mark.parametrize("options", [["--scale", "0"], ["--radius-mm", "9"], ["--patch-mm", "-1"]])
def test_command_refuses(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    design, out = tmp_path / "twin.toml", tmp_path / "out"
    save_design(TWIN, design)
    monkeypatch.setattr(sys, "argv", ["wavesim", "compare-engines", str(design), "-o", str(out), *options])
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    assert "error: " in capsys.readouterr().err
    assert not (out / "comparison.csv").exists()
