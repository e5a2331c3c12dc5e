"""Interferograms: a real file, the sides from which instruments look, and files that are refused."""

from __future__ import annotations

import json
import lzma
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from typer.testing import CliRunner

from lensdesign import InputError, SurfaceFigureSource, load_design, save_design
from lensdesign.analysis import form_errors
from lensdesign.cli.commands import app
from lensdesign.files import read_interferogram, read_surface_figure_grid
from lensdesign.files.interferograms import Interferogram, Side, figure_map

pytest.importorskip("prysm")

GOLDEN = Path(__file__).parents[2] / "golden" / "interferogram" / "flat.dat.xz"
DROPOUTS = GOLDEN.with_name("dropouts20.dat")
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
    with pytest.raises(InputError, match=r"spacing_mm = -1: must be 1e-05 to 1000 mm"):
        read_interferogram(flat, -1.0)


@pytest.mark.parametrize("kept", [3, 10, 500, 5000, 900_000])
def test_files_that_are_cut_short_are_refused(flat: Path, kept: int) -> None:
    flat.write_bytes(flat.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"no Zygo file|cut short"):
        read_interferogram(flat)


def write_datx(
    path: Path, values: Any = None, unit: str = "NanoMeters", spacing: tuple[float, str | None] | None = None
) -> Path:
    """A file of Mx with a wedge of 100 points, or other values."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        data = np.arange(100.0).reshape(10, 10) if values is None else values
        surface = file.create_dataset("Data/Surface/{1}", data=data)
        surface.attrs["No Data"] = np.array([1e300])
        surface.attrs["Wavelength"] = np.array([632.8e-9])
        surface.attrs["Unit"] = np.array([unit.encode()], dtype=object).astype("S")
        surface.attrs["Interferometric Scale Factor"], surface.attrs["Obliquity Factor"] = [0.5], [1.0]
        attributes = file.create_group("Attributes/{2}").attrs
        if spacing is not None:
            attributes["Data Context.Lateral Resolution:Value"] = np.array([spacing[0]])
            if spacing[1] is not None:
                attributes["Data Context.Lateral Resolution:Unit"] = np.array([spacing[1].encode()])
    return path


@pytest.mark.parametrize(
    ("unit", "height_mm"),
    [
        ("NanoMeters", 1e-6),
        ("MicroMeters", 1e-3),
        ("MilliMeters", 1.0),
        ("Meters", 1e3),
        ("Angstroms", 1e-7),
        ("MicroInches", 25.4e-6),
        ("Fringes", 0.5 * 632.8e-6),
    ],
)
def test_a_newer_file_is_read_by_its_units(tmp_path: Path, unit: str, height_mm: float) -> None:
    stored = np.linspace(-1e-4, 1e-4, 100).reshape(10, 10)
    found = read_interferogram(write_datx(tmp_path / "map.datx", stored, unit), 0.02)
    np.testing.assert_allclose(found.height_mm, height_mm * stored, rtol=1e-12)


@pytest.mark.parametrize(
    ("value", "unit"),
    [(1e-4, None), (1e-4, "Meters"), (0.1, "MilliMeters"), (100.0, "MicroMeters"), (0.1 / 25.4, "Inches")],
)
def test_the_lateral_resolution_is_read_by_its_unit(tmp_path: Path, value: float, unit: str | None) -> None:
    found = read_interferogram(write_datx(tmp_path / "map.datx", spacing=(value, unit)))
    assert found.spacing_mm == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"unit": "Smiles"}, "heights in 'Smiles': must be in Fringes or Meters"),
        ({"spacing": (3.0, "Pixels")}, "Lateral Resolution in 'Pixels'.*give spacing_mm"),
        ({"spacing": (1e200, "Meters")}, "distance between points = 1e.203: must be 1e-05 to 1000 mm"),
        ({"spacing": (np.nan, "Meters")}, "Lateral Resolution:Value = nan: must be a finite number"),
        ({"values": np.full((10, 10), 1e299)}, "a height of 1e.293 mm"),
        ({"values": np.full((10, 10), 1.0 + 1.0j)}, "values of type complex128: must be real"),
        ({"values": np.zeros(100)}, r"shape \(100,\): must be \(rows, columns\)"),
        ({"values": np.full((10, 10), np.nan)}, "no measured points"),
        ({}, "states no distance between its points; give spacing_mm"),
    ],
)
def test_a_newer_file_that_is_not_understood_is_refused(
    tmp_path: Path, arguments: dict[str, Any], message: str
) -> None:
    path = write_datx(tmp_path / "map.datx", **arguments)
    needs_spacing = "spacing" not in arguments and arguments
    with pytest.raises(InputError, match=message) as caught:
        read_interferogram(path, 0.1 if needs_spacing else None)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "kind", ["soft link", "external link", "external storage", "virtual", "huge", "chunk"]
)
def test_maps_outside_their_file_and_declared_sizes_are_refused(tmp_path: Path, kind: str) -> None:
    h5py = pytest.importorskip("h5py")
    other = write_datx(tmp_path / "other.datx")
    path = write_datx(tmp_path / "map.datx")
    with h5py.File(path, "r+") as file:
        maps, name = file["Data/Surface"], "{1}"
        attributes = dict(maps[name].attrs)
        del maps[name]
        if kind == "soft link":
            maps[name] = h5py.SoftLink("/Attributes/{2}")
        elif kind == "external link":
            maps[name] = h5py.ExternalLink(other.name, "/Data/Surface/{1}")
        elif kind == "external storage":
            maps.create_dataset(name, (10, 10), "f8", external=[(str(other), 0, 800)])
        elif kind == "virtual":
            layout = h5py.VirtualLayout((10, 10), "f8")
            layout[:] = h5py.VirtualSource(other, "/Data/Surface/{1}", (10, 10))
            maps.create_virtual_dataset(name, layout)
        elif kind == "huge":
            maps.create_dataset(name, (1_000_000, 1_000_000), "f8", chunks=(1000, 1000))
        else:
            maps.create_dataset(name, (10, 10), "f8", maxshape=(None, None), chunks=(20_000, 20_000))
        if kind not in ("soft link", "external link"):
            maps[name].attrs.update(attributes)
    with pytest.raises(InputError, match=r"is a link|stored in other files|with at most"):
        read_interferogram(path, 0.1)


def test_large_attributes_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = write_datx(tmp_path / "map.datx")
    with h5py.File(path, "r+") as file:
        file["Data/Surface/{1}"].attrs["Wavelength"] = np.zeros(5000)
        file["Data/Surface/{1}"].attrs["Unit"] = np.array([b"Fringes"])
    with pytest.raises(InputError, match=r"Wavelength has the shape \(5000,\): must be a single value"):
        read_interferogram(path, 0.1)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60)
def test_damaged_newer_files_never_end_in_another_error(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    path = write_datx(tmp_path_factory.getbasetemp() / "map.datx", spacing=(1e-4, "Meters"))
    content = bytearray(path.read_bytes())
    for place in rng.integers(0, len(content), 4):
        content[place] = rng.integers(0, 256)
    path.write_bytes(content[: rng.integers(8, len(content) + 1)] if rng.random() < 0.3 else content)
    message, found = "", None
    try:
        found = read_interferogram(path)
    except InputError as error:
        message = str(error)
    if found is None:
        assert str(path) in message
    else:
        assert found.height_mm.ndim == 2
        assert np.nanmax(np.abs(found.height_mm)) <= 1.0
        assert 1e-5 <= found.spacing_mm <= 1e3


def test_a_hole_in_the_middle_is_refused() -> None:
    ring = seen(lambda x, y: np.where(np.hypot(x, y) < 0.5, np.nan, 1e-5 * x), "back")
    with pytest.raises(InputError, match=r"areas? without data in the middle"):
        figure_map(ring, "back")


def with_holes(height: Any, places_mm: list[tuple[float, float]], size: int = 1) -> Interferogram:
    """The map of a back with dropouts at these places (x, y)."""
    whole = seen(height, "back")
    values = whole.height_mm.copy()
    rows, columns = (np.flatnonzero(np.isfinite(values).any(axis=axis)) for axis in (1, 0))
    for x, y in places_mm:
        row = round(0.5 * (rows[0] + rows[-1]) - y / SPACING_MM)
        column = round(0.5 * (columns[0] + columns[-1]) + x / SPACING_MM)
        values[row : row + size, column : column + size] = np.nan
    return Interferogram(values, SPACING_MM)


def bent(x: Any, y: Any) -> Any:
    return 1e-4 * x - 2e-4 * y + 3e-5 * (x * x + y * y) + 1e-5 * (x * x - y * y)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_isolated_dropouts_are_bridged_and_counted(size: int) -> None:
    places = [(0.0, 0.0), (1.5, -0.4), (-1.0, 1.2), (0.3, 2.0), (-2.1, -0.9)]
    whole, found = figure_map(seen(bent, "back"), "back"), figure_map(with_holes(bent, places, size), "back")
    assert found.bridged_points == len(places) * size**2
    assert found.semi_diameter_mm == whole.semi_diameter_mm
    np.testing.assert_allclose(found.sag_error_mm, whole.sag_error_mm, atol=1e-12)
    assert found.tilt_deg == pytest.approx(whole.tilt_deg, rel=1e-9)
    assert found.power_um == pytest.approx(whole.power_um, rel=1e-9)
    assert found.pv_um == pytest.approx(whole.pv_um, rel=1e-9)


def test_spikes_are_ignored_and_counted() -> None:
    whole, spiked = seen(bent, "back"), seen(bent, "back")
    spiked.height_mm[30, 35], spiked.height_mm[20, 30] = 0.9, -0.5
    found = figure_map(spiked, "back")
    assert (found.ignored_points, found.bridged_points) == (2, 2)
    np.testing.assert_allclose(found.sag_error_mm, figure_map(whole, "back").sag_error_mm, atol=1e-12)


def test_tilt_is_fitted_to_the_whole_disc_if_an_area_is_missing_beside_the_middle() -> None:
    whole, found = (
        figure_map(one, "back") for one in (seen(bent, "back"), with_holes(bent, [(1.5, 0.0)], 8))
    )
    assert found.semi_diameter_mm < 1.5
    assert found.tilt_deg == pytest.approx(whole.tilt_deg, rel=0.05)


def test_specks_beside_the_part_do_not_move_its_middle() -> None:
    whole, stray = seen(bent, "back"), seen(bent, "back")
    stray.height_mm[0, 0] = 0.0
    np.testing.assert_allclose(
        figure_map(stray, "back").sag_error_mm, figure_map(whole, "back").sag_error_mm, atol=1e-15
    )


def test_the_command_states_how_many_points_were_bridged(tmp_path: Path) -> None:
    outcome = CliRunner().invoke(
        app, ["figure", str(DROPOUTS), "--side", "front", "-o", str(tmp_path / "a.csv"), "--json"]
    )
    assert outcome.exit_code == 0, outcome.output
    stated = json.loads(outcome.stdout)
    assert stated["bridged_points"] == 19
    assert stated["semi_diameter_mm"] > 5.8
    assert [stated["tilt_x_deg"], stated["tilt_y_deg"]] == pytest.approx([-2e-5, 1.3e-5], abs=1e-6)
    assert not np.isnan(read_surface_figure_grid(tmp_path / "a.csv")[0][60, 60])
