"""The resolving test."""

import json
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.fft
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from lensdesign import load_design, save_design
from lensdesign.errors import InputError
from lensdesign.lens.scaling import scaled
from wavesim.cli.commands import app, main
from wavesim.engines.choosing import engine_for
from wavesim.fields.field import Grid, correlation
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics import resolving
from wavesim.metrics.resolving import (
    LineContrast,
    Resolved,
    bars_field,
    contrasts_of,
    meridional_scene,
    register,
    resolve,
    resolving_seconds,
    usual_line_widths_um,
)
from wavesim.plots.resolving import resolving_figure
from wavesim.scene.engine import Cost, Engine
from wavesim.scene.scene import Scene

TWIN = scaled(load_design("designs/paper_singlet.toml"), 0.125)
GRID = Grid((2400,), 5e-5, -1.0)


def speckle(cycles_per_mm: float) -> np.ndarray:
    rng = np.random.default_rng(5)
    values = np.zeros(GRID.shape, complex)
    inside = slice(800, 1600)
    values[inside] = rng.standard_normal(800) + 1j * rng.standard_normal(800)
    spectrum = np.fft.fft(values)
    spectrum[np.abs(np.fft.fftfreq(*GRID.shape, GRID.pitch_mm)) > cycles_per_mm] = 0.0
    return np.fft.ifft(spectrum)


@settings(max_examples=8)
@given(st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_registration_finds_defocus_and_shift(distance_mm: float, shift_mm: float) -> None:
    target = speckle(900.0)
    cycles = np.fft.fftfreq(2 * len(target), GRID.pitch_mm)
    kz = 2.0 * np.pi * np.sqrt(np.maximum((1e3 / 0.532) ** 2 - cycles**2, 0.0))
    moved = np.fft.fft(target, 2 * len(target)) * np.exp(-1j * kz * distance_mm)
    moved = np.fft.ifft(moved * np.exp(-2j * np.pi * cycles * shift_mm))[: len(target)]
    refocus, shift, back = register(moved, target, GRID, 0.532)
    assert refocus == pytest.approx(distance_mm, abs=2e-5)
    assert shift == pytest.approx(shift_mm, abs=2e-5)
    assert correlation(back, target) > 0.999


@given(st.floats(0.3, 2.0), st.integers(5, 9))
def test_bars_have_their_widths(line_width_um: float, bars: int) -> None:
    grid = Grid((8000,), 1e-5, -1.0, (0.0, 0.3))
    field = bars_field(grid, 0.532, line_width_um, bars)
    assert field.values.real.sum() * grid.pitch_mm == pytest.approx(1e-3 * bars * line_width_um, rel=1e-9)
    np.testing.assert_allclose(field.values, field.values[::-1], atol=1e-9)
    lit = grid.y_mm[np.abs(field.values) > 0.5]
    assert np.ptp(lit) == pytest.approx(1e-3 * (2 * bars - 1) * line_width_um, abs=2.1e-5)


def test_the_reference_brings_its_own_lines_back() -> None:
    found = resolve(TWIN, [0.775], engine="eikonal", plane_distance_mm=0.25)
    (line,) = found.lines
    assert line.exit_correlation == pytest.approx(1.0, abs=1e-9)
    assert abs(line.refocus_um) < 0.1
    assert abs(line.shift_um) < 0.01
    assert line.contrast == pytest.approx(line.contrast_of_reference, abs=1e-3)
    assert line.contrast > 0.9


def test_vertical_compensation_loses_the_lines_that_oblique_keeps() -> None:
    warnings.simplefilter("ignore", SamplingWarning)
    contrast = {}
    for kind in ("vertical", "oblique"):
        found = resolve(TWIN, [0.775], 0.1, "slices", plane_distance_mm=0.25, slices=10, compensation=kind)
        contrast[kind] = found.lines[0]
    assert contrast["oblique"].contrast > 0.9
    assert contrast["oblique"].exit_correlation > 0.95
    assert contrast["vertical"].exit_correlation < 0.8
    assert abs(contrast["vertical"].refocus_um) > abs(contrast["oblique"].refocus_um)


def line(width_um: float, contrast: float, weakest: float | None = None) -> LineContrast:
    least = contrast if weakest is None else weakest
    return LineContrast(contrast, least, width_um, contrast, 1.0, 0.0, 0.0, 1.0, np.empty(0))


def outcome(*lines: LineContrast, field_mm: float = 0.0, engine: str = "eikonal") -> Resolved:
    return Resolved(field_mm, engine, "eikonal", {}, lines)


def test_false_resolution_does_not_count() -> None:
    falls_and_returns = outcome(line(0.6, 0.5), line(2.0, 0.9), line(1.0, 0.3), line(0.8, 0.1))
    assert falls_and_returns.smallest_resolved_um() == 1.0
    assert falls_and_returns.smallest_resolved_um(0.5) == 2.0
    assert outcome(line(2.0, 0.1), line(1.0, 0.9)).smallest_resolved_um() is None
    # Enough contrast on the mean, but one gap as bright as a bar.
    assert outcome(line(2.0, 0.9), line(1.0, 0.4, -0.1)).smallest_resolved_um() == 2.0


def test_the_limit_of_lines_is_named() -> None:
    def ends(*lines: LineContrast) -> str:
        return replace(outcome(*lines), passed_um=0.8).limit()

    assert ends(line(2.0, 0.9), line(1.0, 0.1)) == "engine"
    assert ends(line(2.0, 0.9), line(1.0, 0.8)) == "widths"
    assert ends(line(2.0, 0.9), line(0.7, 0.1)) == "aperture"
    assert ends(line(1.0, 0.1)) == "engine"
    assert ends(line(2.0, 0.9), replace(line(1.0, 0.1), contrast_of_reference=0.1)) == "reference"
    found = resolve(TWIN, [0.775, 0.41], engine="eikonal", plane_distance_mm=0.25)
    assert found.passed_um == pytest.approx(0.532)
    assert found.limit() == "aperture"


@pytest.mark.parametrize("wavelength_um", [None, 0.6328])
def test_usual_lines_begin_at_the_diffraction_limit(wavelength_um: float | None) -> None:
    widths = usual_line_widths_um(TWIN, wavelength_um)
    limit_um = 0.5 * (wavelength_um or 0.532) / 0.5
    assert len(widths) == 10
    assert widths[0] == pytest.approx(limit_um, rel=2e-3)
    assert widths[0] >= limit_um * (1.0 - 1e-9)
    assert widths[-1] == pytest.approx(3.0 * limit_um, rel=2e-3)
    assert np.ptp(np.diff(np.log(widths))) < 6e-3


def test_a_chart_shows_the_diffraction_limit_where_lines_reach_it() -> None:
    def texts(*lines: LineContrast) -> str:
        axes = resolving_figure([replace(outcome(*lines), passed_um=0.532)]).axes[0]
        return " ".join(text.get_text() for text in axes.texts)

    assert "diffraction limit 0.532 µm" in texts(line(0.55, 0.9), line(1.0, 0.9))
    assert "diffraction limit" not in texts(line(2.0, 0.9), line(3.0, 0.9))


@pytest.mark.parametrize("samples", [0.3, 1.0, -2.0, 5.0])
def test_displaced_lines_are_registered(samples: float) -> None:
    grid = Grid((4000,), 5e-5, -1.0)
    lines = bars_field(grid, 0.532, 1.0)
    cycles = scipy.fft.fftfreq(grid.size, grid.pitch_mm)
    wave = np.exp(-2j * np.pi * cycles * samples * grid.pitch_mm)
    moved = scipy.fft.ifft(scipy.fft.fft(lines.values) * wave)
    refocus, shift, back = register(moved, lines.values, grid, 0.532)
    assert shift / grid.pitch_mm == pytest.approx(samples, abs=0.1)
    assert abs(refocus) < 1e-4
    assert contrasts_of(grid, 1.0, 5)(back)[0] > 0.98


def test_weakest_contrast_is_that_of_one_gap() -> None:
    found = resolve(TWIN, [0.775, 0.41], engine="eikonal", plane_distance_mm=0.25)
    wide, fine = found.lines
    assert 0.9 < wide.weakest_contrast <= wide.contrast
    # Beyond the aperture's limit of 0.532 um no grating passes.
    assert not fine.resolved()
    assert fine.weakest_contrast < fine.contrast
    assert found.smallest_resolved_um() == 0.775


class Counted:
    """An engine that takes a second for each passage, and counts them."""

    def __init__(self, engine: Engine, passages: list[str]) -> None:
        self.engine, self.passages = engine, passages

    def __getattr__(self, name: str) -> object:
        if name in ("forward", "adjoint"):
            self.passages.append(name)
        return getattr(self.engine, name)

    def cost(self) -> Cost:
        return Cost(1.0, 100.0, 0)


def test_the_time_told_is_that_of_the_passages_made(monkeypatch: pytest.MonkeyPatch) -> None:
    passages: list[str] = []

    def counted(scene: Scene, name: str, **settings: object) -> Counted:
        return Counted(engine_for(scene, name, **settings), passages)

    monkeypatch.setattr(resolving, "engine_for", counted)
    for name in ("fft_seconds", "pass_seconds", "exponential_seconds"):
        monkeypatch.setattr(resolving, name, lambda *_, **__: 0.0)
    widths = [0.775, 1.0]
    predicted = resolving_seconds(TWIN, widths, engine="eikonal", plane_distance_mm=0.25)
    assert passages == []
    resolve(TWIN, widths, engine="eikonal", plane_distance_mm=0.25)
    assert predicted == 2 * 100.0 + len(passages)


def test_picture_shows_every_engine_at_every_field() -> None:
    slices = {"slices": 30, "compensation": "oblique"}
    results = [
        outcome(line(2.0, 0.9), line(1.0, 0.1), field_mm=0.0),
        outcome(line(2.0, 0.05), line(1.0, -0.3), field_mm=0.1),
        Resolved(0.0, "slices", "eikonal", slices, (line(2.0, 0.9), line(1.0, 0.8))),
    ]
    figure = resolving_figure(results)
    assert len(figure.axes) == 2
    said = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in figure.axes]
    assert said == [
        ["eikonal: down to 2 µm", "30 slices, oblique compensation: down to 1 µm"],
        ["eikonal: none resolved"],
    ]
    assert figure.axes[0].get_ylim()[0] < -0.3
    with pytest.raises(InputError, match="one result"):
        resolving_figure([])


def test_the_scene_holds_bars_and_footprint() -> None:
    scene = meridional_scene(TWIN, 1.55, 0.1, plane_distance_mm=0.25)
    assert scene.object_grid.half_widths_mm[0] > 4.5 * 1.55e-3 + 0.05
    assert scene.object_grid.centre_mm == (0.0, 0.1)
    assert scene.exit_grid.half_widths_mm[0] > 10.06 / 8


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"line_widths_um": []}, "at least one width"),
        ({"line_widths_um": [0.0]}, "from 0.01 to 1000"),
        ({"line_widths_um": [float("nan")]}, "from 0.01 to 1000"),
        ({"line_widths_um": [1.0], "field_mm": 0.3}, "half field of 0.1875 mm"),
        ({"line_widths_um": [1.0], "bars": 4}, "at least 5"),
        ({"line_widths_um": [1.0], "bars": 100_000}, "within the field"),
        ({"line_widths_um": [1.0], "wavelength_um": -1.0}, "wavelength_um = -1.0"),
        ({"line_widths_um": [1.0], "plane_distance_mm": 1e9}, "plane_distance_mm = 1e"),
        ({"line_widths_um": [1.0], "engine": "slice"}, "slices"),
        ({"line_widths_um": [1.0], "reference": "truth"}, "no such engine"),
        ({"line_widths_um": [1.0], "plane_distance_mm": -0.1}, "exit vertex"),
    ],
)
def test_refused(arguments: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        resolve(TWIN, **arguments)


@pytest.fixture
def twin_file(tmp_path: Path) -> Path:
    path = tmp_path / "twin.toml"
    save_design(TWIN, path)
    return path


def test_command_prints_contrasts(twin_file: Path) -> None:
    options = ["--linewidths-um", "1.55,0.775", "--field-heights-mm", "0,0.1", "--plane-distance-mm", "0.25"]
    engine = ["--engine", "slices", "--slices", "30", "--compensation", "oblique"]
    result = CliRunner().invoke(app, ["resolve-lines", str(twin_file), *options, *engine, "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert np.shape(found["contrast"]) == (2, 2)
    assert np.all(np.array(found["contrast"]) > 0.9)
    assert found["linewidths_um"] == [1.55, 0.775]
    for key in ("refocus_um", "shift_um", "contrast_as_is", "exit_correlation"):
        assert np.all(np.isfinite(found[key]))
    shown = CliRunner().invoke(app, ["resolve-lines", str(twin_file), *options, *engine])
    limits = "contrast of 0.5 or more down to 0.775 µm, contrast of 0.2 or more down to 0.775 µm"
    assert f"field 0.1 mm: {limits}" in shown.stdout
    assert "-0.000" not in shown.stdout


def test_command_compares_engines_in_one_picture(twin_file: Path, tmp_path: Path) -> None:
    picture = tmp_path / "resolved.png"
    options = ["--linewidths-um", "1.0,0.775", "--plane-distance-mm", "0.25", "-o", str(picture)]
    engines = ["--engine", "slices:slices=30,compensation=oblique,spacing=equal", "--engine", "eikonal"]
    result = CliRunner().invoke(app, ["resolve-lines", str(twin_file), *options, *engines, "--json"])
    assert result.exit_code == 0, result.output
    oblique, eikonal = json.loads(result.stdout)["engines"]
    assert oblique["settings"][0]["slices"] == 30
    assert oblique["settings"][0]["spacing"] == "equal"
    assert (oblique["engine"], eikonal["engine"]) == ("slices", "eikonal")
    assert oblique["smallest_resolved_um"] == eikonal["smallest_resolved_um"] == [0.775]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_spacing_is_an_option(twin_file: Path) -> None:
    options = ["--linewidths-um", "0.775", "--plane-distance-mm", "0.25", "--slices", "30", "--json"]
    spacing = ["--compensation", "oblique", "--spacing", "equal-phase"]
    result = CliRunner().invoke(app, ["resolve-lines", str(twin_file), *options, *spacing])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["settings"][0]["spacing"] == "equal-phase"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--engine", "eikonal", "--engine", "slices", "--slices", "30"], "several --engine"),
        (["--engine", "slices:30"], "--engine = 'slices:30'"),
        (["--engine", "slices:slices=x"], "slices"),
        (["--engine", "eikonal:slices=3"], "slices"),
        (["--spacing", "x"], "spacing"),
        (["-o", "picture.gif"], "must end in one of .png"),
        (["--linewidths-um", "a"], "--linewidths-um = 'a'"),
        (["--bars", "3"], "bars = 3"),
        (["--engine", "x"], "engine = 'x'"),
        (["--slices", "-3"], "--slices = -3"),
        (["--tile-width-mm", "0.1"], "tile_width_mm"),
    ],
)
def test_command_refuses(
    twin_file: Path,
    options: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["wavesim", "resolve-lines", str(twin_file), "--plane-distance-mm", "0.25", *options]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 2
    said = capsys.readouterr().err
    assert message in said
    assert "Traceback" not in said
