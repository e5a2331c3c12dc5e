"""What lens files share: numbers, breaks, dummies, glasses; and a lens through both formats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lensdesign import InputError, Lens, MaterialError, Pose
from lensdesign.files.assembly import assemble, fold_dummy_planes
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.draft import (
    CoordinateBreak,
    Draft,
    Imported,
    Supplement,
    SurfaceRow,
    find_glass,
    parse_number,
    pose_break,
    pose_distances,
    read_lines,
)
from lensdesign.files.zemax import read_zmx, write_zmx

SUPPLEMENT = Supplement(field_diameter_mm=1.0, numerical_aperture=0.05, pixel_pitch_um=3.0, pixels=(10, 10))


def row(thickness_mm: float, name: str = "surface", **values: object) -> SurfaceRow:
    return SurfaceRow(name, f"lens, {name}", thickness_mm=thickness_mm, **values)  # type: ignore[arg-type]


def lens_rows() -> list[SurfaceRow]:
    """An object, a singlet and an image."""
    front = row(5.0, radius_mm=50.0, material=1.5, semi_diameter_mm=4.0, stop=True)
    return [row(100.0, "object"), front, row(90.0, radius_mm=-50.0), row(0.0, "image")]


def assembled(rows: list[SurfaceRow], supplement: Supplement = SUPPLEMENT, lossy: bool = False) -> Imported:
    return assemble(Draft("lens", wavelengths_um=[0.5], rows=rows), supplement, lossy)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_are_read_as_printed(value: float) -> None:
    assert parse_number(repr(value), "") == value
    assert parse_number(f"{value:.17E}".replace("E", "D"), "") == value


@pytest.mark.parametrize(
    "text", ["", "nan", "inf", "-Infinity", "1,5", "1_0", "0x10", "1e999", "١", "1" * 401, "--1"]
)
def test_what_is_no_number_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"here: .* must be a finite number"):
        parse_number(text, "here")


def test_lines_end_as_anyone_ends_them(tmp_path: Path) -> None:
    path = tmp_path / "text"
    path.write_bytes(b"a\r\nb\rc\nd\x85e")
    assert read_lines(path) == ["a", "b", "c", "d\x85e"]
    with pytest.raises(InputError, match=r"'a.*00b'"):
        read_lines("a\0b")


@pytest.mark.parametrize("order", [False, True])
def test_only_an_inverse_undoes_a_break(order: bool) -> None:
    axes = CoordinateBreak((0.1, 0.2), (1.0, 2.0, 0.0), order)
    assert axes.inverse().undoes(axes)
    assert not axes.undoes(axes)
    assert not CoordinateBreak((-0.1, -0.2), (-1.0, -2.0, 0.0), order).undoes(axes)
    shift = CoordinateBreak((0.1, 0.2), (0.0, 0.0, 0.0), order)
    assert CoordinateBreak((-0.1, -0.2), (0.0, 0.0, 0.0), order).undoes(shift)


def test_dummy_planes_are_folded_into_the_space_before() -> None:
    rows = lens_rows()
    dummies = [rows[0], row(-10.0), row(10.0), *rows[1:3], row(0.0), row(2.0), rows[-1]]
    assert [r.thickness_mm for r in fold_dummy_planes(dummies)] == [100.0, 5.0, 92.0, 0.0]
    lens = assembled(dummies).lens
    assert (len(lens.surfaces), lens.sensor.plane_distances_mm) == (2, (92.0,))
    assert lens.object.working_distance_mm == 100.0
    nothing = [rows[0], row(5.0), row(5.0), rows[-1]]
    with pytest.raises(InputError, match="only planes in air"):
        assembled(nothing)
    kept = [*rows[:3], row(2.0, semi_diameter_mm=3.0), rows[-1]]
    assert len(assembled(kept).lens.surfaces) == 3


@pytest.mark.parametrize("tilt_first", [False, True])
def test_a_pair_of_breaks_is_a_pose(tilt_first: bool) -> None:
    """A tilt about one axis alone may stand in either order."""
    pose = Pose(tilt_x_deg=1.5, pivot_z_mm=2.0)
    rows = lens_rows()
    lens = assembled(rows).lens
    distances = pose_distances(lens, pose)
    axes = pose_break(pose)
    axes = CoordinateBreak(axes.decenter_mm, axes.tilt_deg, tilt_first)
    posed = [
        row(distances[0], "object"),
        row(distances[1], axes=axes),
        rows[1],
        row(distances[2], radius_mm=-50.0),
        row(distances[3], axes=axes.inverse()),
        rows[-1],
    ]
    result = assembled(posed)
    assert (result.lens, result.pose) == (lens, pose)


@pytest.mark.parametrize(
    "axes",
    [
        CoordinateBreak((0.1, 0.0), (1.0, 0.0, 0.0), reverse=True),
        CoordinateBreak((0.0, 0.0), (1.0, 2.0, 0.0), reverse=True),
        CoordinateBreak((0.0, 0.0), (0.0, 0.0, 3.0)),
    ],
)
def test_other_breaks_are_a_loss(axes: CoordinateBreak) -> None:
    rows = lens_rows()
    broken = [
        rows[0],
        row(0.0, "first", axes=axes),
        *rows[1:-1],
        row(0.0, "second", axes=axes.inverse()),
        rows[-1],
    ]
    with pytest.raises(InputError, match="first: coordinate break that is not a pose"):
        assembled(broken)
    result = assembled(broken, lossy=True)
    assert (result.lens, len(result.dropped)) == (assembled(rows).lens, 2)


def test_breaks_that_do_nothing_are_no_loss() -> None:
    rows = lens_rows()
    assert assembled([rows[0], row(0.0, axes=CoordinateBreak()), *rows[1:]]).lens == assembled(rows).lens


def test_a_plane_that_ends_a_glass_behind_a_break_is_kept() -> None:
    rows = lens_rows()
    block = row(5.0, radius_mm=-50.0, material=1.7)
    ended = [*rows[:2], block, row(0.0, axes=CoordinateBreak()), row(80.0), rows[-1]]
    assert [s.material for s in assembled(ended).lens.surfaces] == [1.5, 1.7, None]


@pytest.mark.parametrize("in_front", [True, False])
@pytest.mark.parametrize("radius_mm", [None, 50.0])
def test_a_stop_that_touches_a_surface_is_its_aperture(in_front: bool, radius_mm: float | None) -> None:
    """Exact for a plane, and a loss for a curved surface, whose sag the stop would follow."""
    stop = row(0.0 if in_front else 90.0, "stop", stop=True, semi_diameter_mm=3.0)
    lens = [
        row(5.0, "front", radius_mm=radius_mm if in_front else 40.0, material=1.5, semi_diameter_mm=4.0),
        row(90.0 if in_front else 0.0, "back", radius_mm=-50.0 if in_front else radius_mm and -radius_mm),
    ]
    rows = [row(100.0, "object"), *([stop, *lens] if in_front else [*lens, stop]), row(0.0, "image")]
    touched = 0 if in_front else 1
    found = assembled(rows, lossy=True)
    text = f"stop: the stop touches {('front', 'back')[touched]} and is read as its aperture"
    assert found.lens.stop_index == touched
    assert len(found.lens.surfaces) == 2
    assert found.lens.sensor.plane_distances_mm == (90.0,)
    assert found.dropped == (() if radius_mm is None else (f"{text}, which has a sag",))
    assert (text in found.remarks) == (radius_mm is None)


def test_a_value_given_along_is_taken_even_if_it_is_wrong() -> None:
    wrong = Supplement(0.0, 1.0, 0.05, 3.0, (10, 10))
    with pytest.raises(InputError, match=r"working_distance_mm = 0\.0.* 0"):
        assembled(lens_rows(), wrong)


def test_an_object_at_infinity_needs_a_working_distance() -> None:
    rows = [row(np.inf, "object"), *lens_rows()[1:]]
    with pytest.raises(InputError, match="lens: the file lacks working_distance_mm; give"):
        assembled(rows)


def test_glasses_are_found_as_the_named_makers_have_them() -> None:
    assert find_glass("F2", ["SCHOTT"], (), "") == "F2"
    assert find_glass("F2", ["HIKARI", "SCHOTT"], (), "") == "Hikari:F2"
    assert find_glass("NBK7", ["SCHOTT"], (), "") == "N-BK7"
    assert find_glass("N-BK7", ["INFRARED"], (), "") == "N-BK7"
    with pytest.raises(MaterialError, match=r"here: .*'NBK7'"):
        find_glass("NBK7", [], (), "here")


def test_former_glasses_of_schott_are_their_successors_with_the_same_formula() -> None:
    remarks: list[str] = []
    assert find_glass("BK7", ["SCHOTT"], (), "", remarks.append) == "N-BK7"
    assert remarks == ["glass BK7 is read as N-BK7, its successor with the same dispersion formula"]
    assert find_glass("SK16", [], (), "") == "N-SK16"
    assert find_glass("SK16", ["HIKARI"], (), "") == "SK16"
    with pytest.raises(MaterialError, match="unknown material 'BK7'"):
        find_glass("BK7", ["SUMITA"], (), "")


@pytest.mark.parametrize(
    ("name", "maker"), [("BK10", None), ("F6", "CDGM"), ("BK8", "LZOS"), ("SK4", "Hikari")]
)
def test_glasses_of_makers_that_a_file_does_not_name_are_not_substituted(
    name: str, maker: str | None
) -> None:
    """LZOS' BK10 has an index of 1.569, Schott's 1.498; F6, F7 and BK8 of other makers differ by 0.01."""
    if maker is None:
        assert find_glass(name, ["SCHOTT"], (), "") == "N-BK10"
        return
    with pytest.raises(MaterialError, match=rf"names \(SCHOTT, MISC\); that of {maker} may differ"):
        find_glass(name, ["SCHOTT", "MISC"], (), "")


def test_a_crystal_is_not_the_glass_of_a_maker_whom_the_file_does_not_name() -> None:
    """CDGM's BAF2 has nd 1.5697, barium fluoride 1.4745."""
    remarks: list[str] = []
    assert find_glass("BAF2", ["MISC", "INFRARED"], (), "", remarks.append) == "BaF2"
    assert len(remarks) == 1
    assert find_glass("BAF2", ["MISC", "CDGM"], (), "") in ("BAF2", "CDGM:BAF2")


def test_a_glass_with_a_maker_s_own_prefix_is_found_with_a_remark() -> None:
    remarks: list[str] = []
    assert find_glass("S-LAH64", ["SCHOTT"], (), "", remarks.append) == "S-LAH64"
    assert remarks == ["glass S-LAH64 is that of Ohara; the file names the catalogues SCHOTT"]


def test_one_lens_through_both_formats(tmp_path: Path, paper_lens: Lens) -> None:
    pose = Pose(0.1, -0.2, 0.3, 1.0, 2.0, 4.0)
    write_zmx(paper_lens, tmp_path / "a.zmx", pose)
    first = read_zmx(tmp_path / "a.zmx")
    write_seq(first.lens, tmp_path / "b.seq", first.pose)
    second = read_seq(tmp_path / "b.seq")
    assert (second.lens, second.pose) == (paper_lens, pose)


def test_a_stop_without_an_aperture_is_as_wide_as_the_marginal_ray(tmp_path: Path) -> None:
    """Half of the entrance pupil where the stop comes first; the cone's height where the object is near."""
    rows = lens_rows()
    rows[1] = row(5.0, radius_mm=50.0, material=1.5, stop=True)
    pupil = Draft("lens", wavelengths_um=[0.5], rows=rows, aperture=("pupil_diameter_mm", 8.0))
    found = assemble(pupil, SUPPLEMENT, False)
    assert found.lens.surfaces[0].semi_diameter_mm == pytest.approx(4.0, rel=1e-12)
    assert found.remarks == (
        "surface: the stop has no aperture in the file; its semi-diameter is 4 mm, the height of the "
        "marginal ray",
    )
    cone = Draft("lens", wavelengths_um=[0.5], rows=rows, aperture=("object_na", 0.05))
    semi = assemble(cone, SUPPLEMENT, False).lens.surfaces[0].semi_diameter_mm
    assert semi == pytest.approx(100.0 * 0.05 / np.sqrt(1 - 0.05**2), rel=1e-12)


SHIFT = CoordinateBreak((0.3, -0.2))


def placed(breaks: list[tuple[int, CoordinateBreak, float]]) -> list[SurfaceRow]:
    """Return the rows of the lens with coordinate breaks and their distances in front of some of them."""
    rows = lens_rows()
    for place, axes, distance_mm in sorted(breaks, key=lambda entry: -entry[0]):
        before = rows[place - 1]
        rows[place - 1] = replace(before, thickness_mm=before.thickness_mm - distance_mm)
        rows.insert(place, row(distance_mm, axes=axes))
    return rows


@pytest.mark.parametrize(
    "breaks",
    [
        [(1, SHIFT, 0.0), (3, SHIFT.inverse(), 0.0)],  # returns at the image
        [(1, SHIFT, 0.0), (3, SHIFT.inverse(), 80.0)],
        [(1, SHIFT, 20.0), (3, CoordinateBreak((-0.3, 0.0)), 10.0), (3, CoordinateBreak((0.0, 0.2)), 30.0)],
        [
            (1, CoordinateBreak((0.3, 0.0)), 5.0),
            (1, CoordinateBreak((0.0, -0.2)), 1.0),
            (3, SHIFT.inverse(), 2.0),
        ],
        # each surface is decentered and returned by itself
        [(1, SHIFT, 0.0), (2, SHIFT.inverse(), 1.0), (2, SHIFT, 2.0), (3, SHIFT.inverse(), 3.0)],
    ],
)
def test_decenters_that_return_anywhere_are_one_pose(
    breaks: list[tuple[int, CoordinateBreak, float]],
) -> None:
    plain = assembled(lens_rows())
    result = assembled(placed(breaks))
    assert (result.pose.decenter_x_mm, result.pose.decenter_y_mm) == (0.3, -0.2)
    assert result.dropped == ()
    assert result.lens.surfaces == plain.lens.surfaces
    assert result.lens.object == plain.lens.object
    assert result.lens.sensor.plane_distances_mm == pytest.approx(plain.lens.sensor.plane_distances_mm)


def test_a_tilt_that_a_second_break_completes_is_a_pose() -> None:
    """A decenter and a tilt of two breaks, returned at the front vertex, place the lens as one break does."""
    tilt = CoordinateBreak(tilt_deg=(1.5, 0.0, 0.0))
    rows = lens_rows()
    length_mm = rows[1].thickness_mm
    broken = [
        rows[0],
        row(0.0, axes=SHIFT),
        row(0.0, axes=tilt),
        rows[1],
        replace(rows[2], thickness_mm=-length_mm),
        row(0.0, axes=tilt.inverse()),
        row(length_mm + rows[2].thickness_mm, axes=SHIFT.inverse()),
        rows[-1],
    ]
    result = assembled(broken)
    assert result.pose == Pose(0.3, -0.2, 0.0, 1.5)
    assert result.lens == assembled(lens_rows()).lens


@pytest.mark.parametrize(
    "breaks",
    [
        [(1, SHIFT, 0.0)],
        [(1, SHIFT, 0.0), (3, CoordinateBreak((-0.3, 0.1)), 0.0)],
        [(2, SHIFT, 0.0), (3, SHIFT.inverse(), 0.0)],
        [
            (1, CoordinateBreak(tilt_deg=(1.0, 0.0, 0.0)), 0.0),
            (3, CoordinateBreak(tilt_deg=(-1.0, 0.0, 0.0)), 0.0),
        ],
    ],
)
def test_places_of_no_pose_are_a_loss(breaks: list[tuple[int, CoordinateBreak, float]]) -> None:
    with pytest.raises(InputError, match="coordinate break that is not a pose"):
        assembled(placed(breaks))
