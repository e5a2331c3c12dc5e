"""Interferograms: a real file, the sides from which instruments look, and files that are refused."""

from __future__ import annotations

import json
import lzma
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from lensdesign import InputError, SurfaceFigureSource, load_design, save_design
from lensdesign.analysis import form_errors
from lensdesign.cli.commands import app
from lensdesign.files import read_interferogram, read_surface_figure_grid
from lensdesign.files.interferograms import Interferogram, Side, figure_map

pytest.importorskip("prysm")

GOLDEN = Path(__file__).parents[2] / "golden" / "interferogram" / "flat.dat.xz"
SPACING_MM = 0.1


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    path = tmp_path / "flat.dat"
    path.write_bytes(lzma.decompress(GOLDEN.read_bytes()))
    return path


def seen(height: Any, side: Side, points: int = 61) -> Interferogram:
    """A round map of a height over the (x, y) of a lens, as the camera of an instrument shows it."""
    half = 0.5 * SPACING_MM * (points - 1)
    x, y = np.meshgrid(np.linspace(-half, half, points), np.linspace(half, -half, points))
    x = -x if side == "front" else x  # +x is on the left of someone who looks along +z with +y above
    values: NDArray[Any] = np.where(np.hypot(x, y) <= half, height(x, y), np.nan)
    frame = np.full((points + 7, points + 12), np.nan)
    frame[3 : 3 + points, 10 : 10 + points] = values
    return Interferogram(frame, SPACING_MM)


def test_a_real_file_has_the_size_and_the_errors_that_its_instrument_states(flat: Path) -> None:
    found = read_interferogram(flat)
    assert found.height_mm.shape == (432, 425)
    assert found.spacing_mm == pytest.approx(0.1179242, rel=1e-6)
    assert 1e6 * np.ptp(found.height_mm[np.isfinite(found.height_mm)]) == pytest.approx(330.70, abs=0.01)


@pytest.mark.parametrize(("side", "sign"), [("front", -1.0), ("back", 1.0)])
def test_a_bump_stands_where_and_as_it_does_on_the_lens(side: Side, sign: float) -> None:
    def bump(x: Any, y: Any) -> Any:
        return 1e-4 * np.exp(-((x - 1.0) ** 2 + (y - 0.5) ** 2) / 0.1)

    found = figure_map(seen(bump, side), side)
    rows, columns = found.sag_error_mm.shape
    row, column = np.unravel_index(np.nanargmax(sign * found.sag_error_mm), found.sag_error_mm.shape)
    assert SPACING_MM * (column - 0.5 * (columns - 1)) == pytest.approx(1.0, abs=1e-9)
    assert SPACING_MM * (row - 0.5 * (rows - 1)) == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("side", ["front", "back"])
def test_alignment_is_removed_and_power_only_if_not_kept(side: Side) -> None:
    sign = -1.0 if side == "front" else 1.0

    def height(x: Any, y: Any) -> Any:
        return sign * (2e-4 + 1e-4 * x - 2e-4 * y + 3e-5 * (x * x + y * y) + 1e-5 * (x * x - y * y))

    without, kept = (figure_map(seen(height, side), side, keep_power=keep) for keep in (False, True))
    semi = without.semi_diameter_mm
    assert 2.7 < semi < 3.0
    assert without.tilt_deg == pytest.approx(np.degrees([1e-4, -2e-4]), rel=1e-3)
    assert without.power_um == kept.power_um == pytest.approx(1e3 * 3e-5 * semi**2, rel=1e-3)
    assert without.pv_um == pytest.approx(2e3 * 1e-5 * semi**2, rel=0.05)
    assert kept.pv_um == pytest.approx(1e3 * 4e-5 * semi**2, rel=0.05)


def test_the_command_writes_the_figure_of_a_design(
    flat: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = ["figure", str(flat), "--side", "front", "-o", "front.csv", "--spacing-mm", "0.04"]
    outcome = CliRunner().invoke(app, [*arguments, "--json"])
    assert outcome.exit_code == 0, outcome.output
    stated = json.loads(outcome.stdout)
    values, spacing = read_surface_figure_grid("front.csv")
    assert spacing == stated["spacing_mm"] == 0.04
    assert values.shape[::-1] == tuple(stated["points"])
    lens = load_design(Path(__file__).parents[3] / "designs" / "paper_singlet.toml")
    semi_mm = 0.999 * stated["semi_diameter_mm"]
    made = lens.with_surface(0, semi_diameter_mm=semi_mm, figure=SurfaceFigureSource(file=Path("front.csv")))
    save_design(made, tmp_path / "lens.toml")
    (error,) = form_errors(load_design(tmp_path / "lens.toml"))
    assert error.pv_waves == pytest.approx(stated["pv_um"] / 0.6328, rel=0.05)


def test_the_first_bytes_decide_what_a_file_is(tmp_path: Path, flat: Path) -> None:
    other = tmp_path / "picture.dat"
    other.write_bytes(b"P5 2 2 255\n1234")
    with pytest.raises(InputError, match="no Zygo file"):
        read_interferogram(other)
    with pytest.raises(InputError, match="cannot read"):
        read_interferogram(tmp_path / "absent.dat")
    with pytest.raises(InputError, match=r"spacing_mm = -1: must be finite and above 0"):
        read_interferogram(flat, -1.0)


@pytest.mark.parametrize("kept", [3, 10, 500, 5000, 900_000])
def test_files_that_are_cut_short_are_refused(flat: Path, kept: int) -> None:
    flat.write_bytes(flat.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"no Zygo file|cut short"):
        read_interferogram(flat)


def test_a_newer_file_is_read_by_its_units(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "map.datx"
    with h5py.File(path, "w") as file:
        surface = file.create_dataset("Data/Surface/{1}", data=np.arange(100.0).reshape(10, 10))
        surface.attrs["No Data"] = np.array([1e38])
        surface.attrs["Wavelength"] = np.array([632.8e-9])
        surface.attrs["Unit"] = np.array([b"NanoMeters"], dtype=object).astype("S")
        surface.attrs["Interferometric Scale Factor"], surface.attrs["Obliquity Factor"] = [0.5], [1.0]
        attributes = file.create_group("Attributes/{2}")
        attributes.attrs["Data Context.Lateral Resolution:Value"] = np.array([2e-5])
    found = read_interferogram(path, 0.02)
    np.testing.assert_allclose(found.height_mm, 1e-6 * np.arange(100.0).reshape(10, 10))


def test_attributes_of_another_form_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "map.datx"
    with h5py.File(path, "w") as file:
        surface = file.create_dataset("Data/Surface/{1}", data=np.zeros((10, 10)))
        surface.attrs["No Data"], surface.attrs["Wavelength"] = np.array([1e38]), np.array([632.8e-9])
        surface.attrs["Unit"] = np.array([b"NanoMeters"])
        surface.attrs["Interferometric Scale Factor"], surface.attrs["Obliquity Factor"] = [0.5], [1.0]
        file.create_group("Attributes/{2}").attrs["Name"] = "text"
    with pytest.raises(InputError, match="cannot be read as a Zygo file"):
        read_interferogram(path)


def test_a_hole_in_the_middle_is_refused() -> None:
    ring = seen(lambda x, y: np.where(np.hypot(x, y) < 0.5, np.nan, 1e-5 * x), "back")
    with pytest.raises(InputError, match=r"areas? without data in the middle"):
        figure_map(ring, "back")
