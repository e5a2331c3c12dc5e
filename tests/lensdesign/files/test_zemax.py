"""Zemax files: published prescriptions read as they are; designs back without loss; every refusal by name."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import GOLDEN
from supplements import SENSOR, SUPPLEMENT

from lensdesign import CoverGlass, InputError, Lens, MaterialError, Pose, Surface
from lensdesign.analysis.check import check_design
from lensdesign.analysis.paraxial import first_order
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.draft import LossyImportError, Supplement
from lensdesign.files.zemax import radius_mm, read_zmx, write_zmx

HEADER = """VERS 171115
DBDT 0 1 1.000E+10 0.000E+00
MODE SEQ
NAME {name}
NOTE 0 a remark of the maker's
PFIL 0 0 0
LANG 0
UNIT MM X W X CM MR CPMM
ENPD {pupil}
ENVD 20 1 0
GFAC 0 0
GCAT SCHOTT OHARA MISC CORNING INFRARED
SDMA 0 1 0
FTYP 0 0 1 {waves} 0 0 0 1
XFLN 0
YFLN 0
FWGN 1
"""


def zmx_text(
    name: str,
    pupil: float,
    wavelengths_um: tuple[float, ...],
    surfaces: list[tuple[str, ...]],
    primary: int = 1,
) -> str:
    """A file as lens makers write it: object at infinity, then the records of each surface."""
    lines = [HEADER.format(name=name, pupil=pupil, waves=len(wavelengths_um)).rstrip()]
    lines += [f"WAVM {i} {w} 1" for i, w in enumerate(wavelengths_um, start=1)]
    lines += [f"WAVM {i} 0.55 1" for i in range(len(wavelengths_um) + 1, 25)]
    lines += [f"PWAV {primary}", "GLRS 1 0", "SURF 0", "  FIMP", "  CURV 0.0", "  DISZ INFINITY"]
    for i, records in enumerate(surfaces, start=1):
        lines += [f"SURF {i}", *(f"  {record}" for record in records)]
    last = len(surfaces) + 1
    lines += [f"SURF {last}", "  FIMP", "  CURV 0.0", "  DISZ 0", '  MEMA 0 0 0 0 1 ""']
    return "\r\n".join([*lines, "TOL TOFF   0   0", "MNUM 1 1", "MOFF   0   1", "EFFL 0 2 0 0 0 0", ""])


def surface(curvature: float | str, distance: float, semi: float, *more: str) -> tuple[str, ...]:
    """Records of one surface."""
    return (f"CURV {curvature!s} 0 0 0 0", f"DISZ {distance!r}", f'DIAM {semi!r} 1 0 0 1 ""', *more)


D = (0.5875618,)
FDC = (0.4861327, 0.5875618, 0.6562725)
EDMUND_38398 = zmx_text(  # Edmund Optics 38-398, plano-convex, 12.5 mm x 15 mm FL, as in its own file
    "38398",
    12.5,
    (0.5876,),
    [
        (
            "STOP",
            "FIMP",
            "CURV 8.496176720475789867E-02",
            "DISZ 3.1000000000000001",
            "GLAS N-SF11",
            'DIAM 5.75 1 0 0 1 ""',
            'OEMA 0.5 0 0 0 0 ""',
            'MEMA 6.25 0 0 0 1 ""',
            "CLAP 0 5.75 0",
        ),
        ("CURV 0.0", "DISZ 13.262120360019384", "MAZH 0 0", 'DIAM 5.75 1 0 0 1 ""', "FLAP 0 5.75 0"),
    ],
)
LA1951 = zmx_text(  # Thorlabs LA1951, plano-convex, R = 13.1 mm, 11.7 mm thick, f = 25.3 mm, fb = 17.6 mm
    "LA1951",
    20.0,
    D,
    [
        surface(1 / 13.1, 11.7, 12.0, "STOP", "TYPE STANDARD", "GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0"),
        surface("0.0", 17.6, 12.0, "TYPE STANDARD"),
    ],
)
AC254_050 = zmx_text(  # Thorlabs AC254-050-A, cemented achromat, f = 50 mm within 1 %, fb = 43.4 mm
    "AC254-050-A",
    22.0,
    FDC,
    [
        surface("0.02999400119976", 9.0, 12.0, "STOP", "GLAS N-BAF10"),
        surface("-0.044883303411131101", 2.5, 12.0, "GLAS N-SF10"),
        surface("-0.0034355996839248002", 43.4, 12.0),
    ],
    primary=2,
)
ACL2520 = zmx_text(  # Thorlabs ACL2520, aspheric condenser of B270, R = 10.462 mm, f = 20.1 mm
    "ACL2520",
    20.0,
    D,
    [
        (
            *surface(1 / 10.462, 12.0, 10.0, "STOP", "TYPE EVENASPH", "CONI -0.6265", "GLAS B270"),
            "PARM 1 0",
            "PARM 2 1.5E-5",
            *(f"PARM {i} 0" for i in range(3, 9)),
        ),
        surface("0.0", 12.1, 11.5),
    ],
)
COOKE = zmx_text(  # The textbook triplet of 50 mm focal length, f/5
    "A SIMPLE COOKE TRIPLET.",
    10.0,
    (0.48, 0.55, 0.65),
    [
        surface(1 / 22.01359, 3.25896, 9.5, "GLAS SK16"),
        surface(-1 / 435.76044, 6.00755, 9.5),
        surface(-1 / 22.21328, 0.99997, 5.0, "GLAS F2"),
        surface(1 / 20.29192, 4.75041, 5.0, "STOP"),
        surface(1 / 79.68360, 2.95208, 7.5, "GLAS SK16"),
        surface(-1 / 18.39533, 42.20778, 7.5),
    ],
    primary=2,
)
TESSAR_INCHES = (  # M. Laikin, Lens Design, 4th ed., p. 63: Tessar f/4.5, here in mm with a scale of 25.4
    (1.3329, 0.2791, "N-SK15"),
    (-9.9754, 0.2054, ""),
    (-2.0917, 0.09, "F2"),
    (1.2123, 0.0709, ""),
    (math.inf, 0.1534, ""),
    (-7.5205, 0.09, "K10"),
    (1.3010, 0.3389, "N-SK15"),
    (-1.5218, 3.4025, ""),
)
TESSAR = zmx_text(
    "Tessar",
    20.0,
    FDC,
    [
        surface(1 / (25.4 * r), 25.4 * t, 5.0, *([f"GLAS {g}"] if g else []), *(["STOP"] if i == 4 else []))
        for i, (r, t, g) in enumerate(TESSAR_INCHES)
    ],
    primary=2,
)


def saved(tmp_path: Path, text: str, encoding: str = "utf-16") -> Path:
    path = tmp_path / "lens.zmx"
    path.write_bytes(text.encode(encoding))
    return path


@pytest.mark.parametrize(
    ("text", "radii", "focal_mm", "back_mm", "digits"),
    [
        (EDMUND_38398, [11.77, None], 15.0, 13.262120360019384, (0.05, 1e-9)),
        (LA1951, [13.1, None], 25.3, 17.6, (0.05, 0.05)),
        (AC254_050, [33.34, -22.28, -291.07], 50.0, 43.4, (0.5, 0.05)),
        (ACL2520, [10.462, None], 20.1, 12.1, (0.1, 0.1)),
        (
            COOKE,
            [22.01359, -435.76044, -22.21328, 20.29192, 79.6836, -18.39533],
            50.0,
            42.20778,
            (0.05, 0.25),
        ),
        (TESSAR, None, 101.6, 86.4235, (0.1, 0.5)),
    ],
    ids=["Edmund 38-398", "LA1951", "AC254-050-A", "ACL2520", "Cooke triplet", "Tessar"],
)
def test_published_prescriptions(
    tmp_path: Path,
    text: str,
    radii: list[float | None] | None,
    focal_mm: float,
    back_mm: float,
    digits: tuple[float, float],
) -> None:
    """Focal lengths to the published digits; triplet and Tessar have their image at the best focus."""
    result = read_zmx(saved(tmp_path, text), SUPPLEMENT)
    lens = result.lens
    if radii is not None:
        assert [s.radius_mm for s in lens.surfaces] == radii
    assert (result.dropped, result.pose) == ((), Pose())
    found = first_order(lens)
    assert found.efl_mm == pytest.approx(focal_mm, abs=digits[0])
    assert found.bfl_mm == pytest.approx(back_mm, abs=digits[1])
    assert lens.sensor.plane_distances_mm[0] == pytest.approx(back_mm)


def test_the_rest_of_a_prescription(tmp_path: Path) -> None:
    lens = read_zmx(saved(tmp_path, COOKE), SUPPLEMENT).lens
    assert lens.title == "A SIMPLE COOKE TRIPLET."
    assert lens.wavelengths_um == (0.55, 0.48, 0.65)
    assert [s.material for s in lens.surfaces] == ["N-SK16", None, "F2", None, "N-SK16", None]
    assert [s.thickness_mm for s in lens.surfaces] == [3.25896, 6.00755, 0.99997, 4.75041, 2.95208, None]
    assert lens.stop_index == 3
    asphere = read_zmx(saved(tmp_path, ACL2520), SUPPLEMENT).lens.surfaces[0]
    assert (asphere.conic, asphere.asphere, asphere.semi_diameter_mm) == (-0.6265, (1.5e-5,), 10.0)


def test_solves_are_remarked(tmp_path: Path) -> None:
    result = read_zmx(saved(tmp_path, EDMUND_38398), SUPPLEMENT)
    assert result.remarks == ("surface 2: MAZH solve or pickup replaced by its present value",)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8", "utf-8-sig", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str) -> None:
    text = COOKE.replace("A SIMPLE", "ÉTUDE D'UN")
    assert read_zmx(saved(tmp_path, text, encoding), SUPPLEMENT).lens.title == "ÉTUDE D'UN COOKE TRIPLET."


def test_records_need_no_indent(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.zmx"
    write_zmx(paper_lens, path)
    text = path.read_text(encoding="utf-16").replace("\n  ", "\n")
    assert read_zmx(saved(tmp_path, text)).lens == paper_lens


def test_coordinate_breaks_put_the_lens_where_the_pose_does(tmp_path: Path, paper_lens: Lens) -> None:
    """Frames walked record by record, as the user's manual defines the coordinate break."""
    path = tmp_path / "lens.zmx"
    pose = Pose(0.1, -0.2, 0.03, 1.5, -0.7, 4.4)
    write_zmx(paper_lens, path, pose)
    frame, vertices = np.eye(4), []
    frame[2, 3] = paper_lens.object_z_mm
    for block in path.read_text(encoding="utf-16").split("SURF ")[1:]:
        records = [line.split() for line in block.splitlines()]
        parameters = {int(r[1]): float(r[2]) for r in records if r[:1] == ["PARM"]}
        if "COORDBRK" in block:
            frame = frame @ break_matrix([parameters[i] for i in range(1, 7)])
        else:
            vertices.append(frame.copy())
        step = np.eye(4)
        step[2, 3] = next(float(r[1]) for r in records if r[:1] == ["DISZ"])
        frame = frame @ step
    rotation, shift = pose.transform()
    for vertex, z in zip(vertices[1:-1], paper_lens.vertex_z_mm, strict=True):
        np.testing.assert_allclose(vertex[:3, :3], rotation[0], atol=1e-14)
        np.testing.assert_allclose(vertex[:3, 3], rotation[0] @ [0.0, 0.0, z] + shift[0], atol=1e-13)
    image = np.eye(4)
    image[2, 3] = paper_lens.sensor_z_mm[0]
    np.testing.assert_allclose(vertices[-1], image, atol=1e-13)


def break_matrix(values: list[float]) -> np.ndarray:
    """Decenter, then right-handed turns about x, y and z; or all that in reverse order."""
    x, y, *tilts, order = values
    decenter = np.eye(4)
    decenter[:2, 3] = x, y
    steps = [decenter]
    for axis, tilt in enumerate(np.deg2rad(tilts)):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[i, i] = turn[j, j] = math.cos(tilt)
        turn[i, j], turn[j, i] = -math.sin(tilt), math.sin(tilt)
        steps.append(turn)
    return np.linalg.multi_dot(steps[::-1] if order else steps)


@given(st.floats(1e-300, 1e300) | st.floats(-1e4, -1e-3))
def test_radii_come_back_from_curvatures_of_many_digits(radius: float) -> None:
    from decimal import Context, Decimal

    digits = str(Context(prec=25).divide(Decimal(1), Decimal(radius)))
    assert radius_mm(digits, "") == radius


@given(st.integers(1, 10**7).map(lambda n: n / 1000))
def test_catalogue_radii_come_back_from_curvatures_of_17_digits(radius: float) -> None:
    assert radius_mm(repr(1.0 / radius), "") == radius
    assert radius_mm(f"{1.0 / radius:.18E}", "") == radius


APERTURES = {
    "OBNA 0.1 0": 0.1,
    "OBNA 30.0 1": 0.5,
    "FLOA": 4e-5,
    "ENPD 0.008": 4e-5,
    "FNUM 4.0 0": None,
    "FNUM 4.0 1": None,
}


@pytest.mark.parametrize(("record", "expected"), APERTURES.items())
def test_apertures(tmp_path: Path, record: str, expected: float | None) -> None:
    """The stop is the front surface, a thin lens; the image F-number is that of a ray from the axis."""
    focal, distance = 50.0, 100.0
    text = zmx_text(
        "thin",
        0.008,
        D,
        [surface(1 / 50.0, 3e-7, 0.004, "STOP", "GLAS MODEL 1 0 2.0 0"), surface("0.0", 100.0, 1.0)],
    )
    text = text.replace("ENPD 0.008", record).replace("INFINITY", repr(distance))
    if expected is None:
        slope = 0.5 / 4.0 * (focal / distance if record.endswith(" 0") else 1.0)  # as 2f images onto 2f
        expected = math.sin(math.atan(slope))
    supplement = Supplement(field_diameter_mm=1.0, pixel_pitch_um=3.0, pixels=(10, 10))
    lens = read_zmx(saved(tmp_path, text), supplement).lens
    assert lens.object.numerical_aperture == pytest.approx(expected, rel=1e-7)


def test_object_heights(tmp_path: Path, paper_lens: Lens) -> None:
    write_zmx(paper_lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text(encoding="utf-16")
    text = text.replace("FTYP 1 0 2", "FTYP 1 0 3").replace("XFLN 0 0", "XFLN 0 0 -3 99")
    text = text.replace("YFLN 0 1.5", "YFLN 0 1.5 4 99")
    assert read_zmx(saved(tmp_path, text)).lens.object.field_diameter_mm == 10.0


def test_a_moved_image_takes_the_noted_planes_with_it_or_loses_them(tmp_path: Path, paper_lens: Lens) -> None:
    write_zmx(paper_lens, tmp_path / "lens.zmx")
    text = (tmp_path / "lens.zmx").read_text(encoding="utf-16").replace("DISZ 2.0", "DISZ 2.5")
    with pytest.raises(LossyImportError, match=r"sensor planes \[2\.0, 22\.0\].* 2\.5 mm"):
        read_zmx(saved(tmp_path, text))
    assert read_zmx(saved(tmp_path, text), lossy=True).lens.sensor.plane_distances_mm == (2.5,)


LOSSES = [
    ("GLAS N-BAF10", "GLAS MIRROR", "surface 1: mirror"),
    ("GLAS N-BAF10", "GLAS ___BLANK 1 0 1.67 47.1 0 0", "surface 1: dispersion"),
    (
        "STOP",
        "TYPE DGRATING\r\n  STOP",
        r"surface 1: surface type 'DGRATING' \(diffraction grating\), read as",
    ),
    ("STOP", "TYPE NURBS\r\n  STOP", "surface 1: surface type 'NURBS', read as STANDARD"),
    ("STOP", "SQAP 3 3\r\n  STOP", "surface 1: rectangular aperture, SQAP '3 3'"),
    ("STOP", "USAP 0 0\r\n  UDAD 1 0 0\r\n  STOP", "surface 1: aperture drawn by the user, USAP '0 0'"),
    ("STOP", "TYPE EVENASPH\r\n  XDAT 1 2.0\r\n  STOP", "surface 1: XDAT 1 of 2"),
    (
        "STOP",
        "TYPE TOROIDAL\r\n  XDAT 1 2\r\n  XDAT 2 100\r\n  XDAT 4 1e-3\r\n  STOP",
        "surface 1: Zernike terms of the toroid, XDAT 4 of 0.001",
    ),
    (
        "STOP",
        "TYPE QED_TYPE\r\n  XDAT 1 0\r\n  XDAT 2 1\r\n  XDAT 3 10\r\n  XDAT 4 1e-3\r\n  CONI -0.7\r\n  STOP",
        "surface 1: conic constant -0.7 of a Qbfs, which is read with a sphere as base",
    ),
    (
        "STOP",
        "TYPE QED_TYPE\r\n  XDAT 1 2\r\n  XDAT 2 1\r\n  XDAT 3 10\r\n  XDAT 4 1e-3\r\n  STOP",
        r"surface 1: Forbes asphere of kind 2, neither 0 \(Qbfs\) nor 1 \(Qcon\)",
    ),
    (
        "STOP",
        "TYPE QED_TYPE\r\n  XDAT 1 1\r\n  XDAT 2 12\r\n  XDAT 3 10\r\n  XDAT 14 1e-3\r\n  STOP",
        "surface 1: more than 10 Forbes terms, XDAT 14 of 0.001",
    ),
    (
        "GLAS N-BAF10",
        "GLAS 670471 0 0",
        r"surface 1: dispersion of the glass number 670471 \(Abbe number 47.1",
    ),
    ("STOP", "CLAP 1 3 0\r\n  STOP", "surface 1: central obscuration of radius 1"),
    ("STOP", "CLAP 0 3 0\r\n  OBDC 1 0\r\n  STOP", "surface 1: decentered aperture"),
    ("STOP", "TYPE EVENASPH\r\n  PARM 1 0.1\r\n  STOP", r"surface 1: asphere term in r\^2 of 0.1"),
    ("STOP", "PARM 3 0.1\r\n  STOP", "surface 1: PARM 3 of 0.1"),
    ("MNUM 1 1", "MNUM 3 1", "3 configurations"),
    ("ENVD 20 1 0", "ENVD 25 1 0", "environment of 25 degrees C and 1 atm"),
    ("FTYP 0 0", "FTYP 0 1", "telecentric object space"),
    ("FWGN 1", "FWGN 1\r\nVCYN 0.2", "vignetting factors"),
    ("FWGN 1", "FWGN 1\r\nXYZW 1 2", r"XYZW '1 2' \(line 18\)"),
    ("  FIMP\r\n  CURV 0.0\r\n  DISZ 0", "  CURV 0.01\r\n  DISZ 0", "surface 4: curved image surface"),
    ("CURV 0.0\r\n  DISZ INF", "CURV 0.1\r\n  DISZ INF", "surface 0: curved object surface"),
    ("DISZ INF", "GLAS F2\r\n  DISZ INF", "surface 0: object in F2, read as air"),
    ("STOP", "TYPE COORDBRK\r\n  PARM 3 1.0\r\n  STOP", "surface 1: coordinate break that is not a pose"),
]


@pytest.mark.parametrize(("old", "new", "message"), LOSSES)
def test_what_would_be_lost_is_listed(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in AC254_050
    path = saved(tmp_path, AC254_050.replace(old, new, 1))
    with pytest.raises(LossyImportError, match=message) as caught:
        read_zmx(path, SUPPLEMENT)
    assert str(path) in str(caught.value)
    assert read_zmx(path, SUPPLEMENT, lossy=True).dropped == caught.value.dropped


FAULTS = [
    ("MODE SEQ", "MODE NSC", "line 3: MODE 'NSC'; only sequential"),
    ("UNIT MM", "UNIT FEET", "line 8: UNIT 'FEET'; lengths must be in MM, CM, IN, METER"),
    ("N-BAF10", "N-BAF10X", r"line 5\d \(surface 1\): .* Or give a glass catalogue \(AGF\) that has it"),
    (
        "N-BAF10",
        "F7",
        r"line 5\d \(surface 1\): glass 'F7' is not known from .* \(SCHOTT.*that of CDGM may differ",
    ),
    ("DISZ 9.0", "DISZ 9,0", "line 50: '9,0' must be a finite number"),
    ("DISZ 9.0", "DISZ nan", "'nan' must be a finite number"),
    ("DISZ 9.0", "DISZ 1e999", "'1e999' must be"),
    ("DISZ 9.0", "DISZ 1_0", "'1_0' must be"),
    ("DISZ 9.0", f"DISZ {'1' * 5000}", r"'1111.*\.\.\.' must be"),
    ("DISZ 9.0", "DISZ", "0 values; at least 1"),
    ("DISZ 9.0", "DISZ 0.0", "surface 1 and surface 2 cross .*their distance is 0 mm"),
    ("DISZ 9.0", "DISZ -9.0", "the next surface lies -9 mm behind surface 1"),
    ("DISZ 9.0", "DISZ INFINITY", "the next surface lies inf mm behind surface 1"),
    ("SURF 2", "SURF 7", "SURF '7' where surface 2 must follow"),
    ("N-BAF10", "N-BAF10X", r"unknown material 'N-BAF10X'; did you mean N-BAF10"),
    ("CURV 0.0", "CURV abc", "'abc' must be"),
    ("PWAV 2", "PWAV 2.5", "'2.5' must be a whole number"),
    ("STOP", "GLAS", "GLAS without a name"),
    ("FWGN 1", "NOTE 0 transferlens pixels [1", r"remark transferlens 'pixels' \(line 17\): not readable"),
    (
        "FWGN 1",
        f"NOTE 0 transferlens pixels {'[' * 100000}",
        r"remark transferlens 'pixels' \(line 17\): not readable",
    ),
    ("FWGN 1", 'NOTE 0 transferlens plane_distances_mm ["x"]\r\nFWGN 1', None),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, old: str, new: str, message: str | None) -> None:
    assert old in AC254_050
    path = saved(tmp_path, AC254_050.replace(old, new, 1))
    if message is None:
        assert read_zmx(path, SUPPLEMENT).lens.sensor.plane_distances_mm == (43.4,)
        return
    with pytest.raises(InputError, match=message) as caught:
        read_zmx(path, SUPPLEMENT)
    assert str(caught.value).startswith(str(path))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        InputError,
        match=r"lacks working_distance_mm, field_diameter_mm, numerical_aperture, pixel_p.*, pixels;",
    ):
        read_zmx(saved(tmp_path, AC254_050))


def test_what_is_no_lens_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "lens.zmx"
    for content, message in [
        (b"", "0 surfaces found"),
        (b"\x00\x01\x02\xff" * 100, "not a text file"),
        (b"\xff\xfeS\x00U", "not valid UTF-16"),
        (b"SURF 0\nSURF 1\nSURF 2\n", r"surface 2, the last one, has no distance \(DISZ\).* cut short"),
        (b"SURF 0\nSURF 1\nSURF 2\nDISZ 3\n", "the last one, has a distance of 3, but the image"),
        (b"SURF 0\nSURF 1\nSURF 2\nDISZ 0\n", "there are only planes in air"),
        (b"SURF 0\n" + b"SURF 1\n" * 3, "where surface 2 must follow"),
        ("\n".join(f"SURF {i}" for i in range(1100)).encode(), "more than 1000 surfaces"),
        (b"X" * 1_000_000, "0 surfaces found"),
    ]:
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            read_zmx(path)


def test_more_asphere_terms_than_the_format_holds_are_not_written(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.zmx"
    with pytest.raises(InputError, match=r"surface 2: 8 asphere terms; a .zmx file holds 7, up to r\^16"):
        write_zmx(paper_lens.with_surface(1, asphere=(0.0,) * 7 + (1e-30,)), path)
    assert not path.exists()


IMPORTS = GOLDEN / "imports"
SINGLET = (IMPORTS / "aperture_smaller_than_stop.zmx").read_text()
RECORD = "N-BK7 0 0 1.5168 64.17"


def glass_of(lens: Lens) -> list[tuple[float | None, object]]:
    return [(s.radius_mm, s.material) for s in lens.surfaces]


def test_a_record_without_indent_stays_in_its_surface() -> None:
    result = read_zmx(IMPORTS / "unindented_record.zmx", SENSOR)
    assert glass_of(result.lens) == [(50.0, "N-BK7"), (-50.0, None)]
    assert result.dropped == ()


RECORDS = [line.strip() for line in SINGLET.splitlines() if line.startswith("  ")]


@pytest.mark.parametrize("record", dict.fromkeys(RECORDS))
def test_no_indent_of_any_record_changes_the_lens(tmp_path: Path, record: str) -> None:
    expected = read_zmx(saved(tmp_path, SINGLET), SENSOR)
    found = read_zmx(saved(tmp_path, SINGLET.replace(f"  {record}", record)), SENSOR)
    assert (found.lens, found.dropped) == (expected.lens, ())
    lower = SINGLET.replace(record, record.lower() if record == "STOP" else record)
    assert read_zmx(saved(tmp_path, lower), SENSOR).lens == expected.lens


def test_an_unknown_record_without_indent_is_a_loss_and_ends_nothing(tmp_path: Path) -> None:
    """In the middle of a surface; the merit function behind the last one is none."""
    text = SINGLET.replace("  STOP", "XYZQ 1 2\n  STOP")
    with pytest.raises(LossyImportError, match="surface 1: XYZQ '1 2'"):
        read_zmx(saved(tmp_path, text), SENSOR)
    result = read_zmx(saved(tmp_path, text), SENSOR, lossy=True)
    assert glass_of(result.lens) == [(50.0, "N-BK7"), (-50.0, None)]
    tail = "\nREAY 3 2 0 1 0 0 2.2 0 0 0\nEFFL 0 2 0 0 0 0 49 1\n"
    with pytest.raises(LossyImportError, match="surface 3: REAY"):
        read_zmx(saved(tmp_path, SINGLET + tail), SENSOR)
    whole = SINGLET + tail + "TOL TOFF 0 0\nMNUM 1 1\nMOFF 0 1\nXYZQ 1 2\n"
    assert read_zmx(saved(tmp_path, whole), SENSOR).dropped == ()
    early = SINGLET.replace("SURF 2", "MOFF 0 1\nXYZQ 1 2\nSURF 2")
    with pytest.raises(LossyImportError, match="surface 1: XYZQ '1 2'"):
        read_zmx(saved(tmp_path, early), SENSOR)
    within = SINGLET.replace("  CURV 0.02", "TOL TOFF 0\nXYZQ 1 2\n  CURV 0.02")
    assert glass_of(read_zmx(saved(tmp_path, within), SENSOR, lossy=True).lens)[0] == (50.0, "N-BK7")
    with pytest.raises(LossyImportError, match="surface 1: XYZQ '1 2'"):
        read_zmx(saved(tmp_path, within), SENSOR)


@pytest.mark.parametrize(
    ("old", "second"),
    [
        ("CURV 0.02", "CURV 0.03"),
        ("DISZ 5", "DISZ 6"),
        ("TYPE STANDARD\n  CURV -", "TYPE EVENASPH\n  CURV -"),
    ],
)
def test_two_records_that_contradict_each_other_are_refused(tmp_path: Path, old: str, second: str) -> None:
    word = old.split()[0]
    text = SINGLET.replace(f"  {old}", f"  {second.partition(chr(10))[0]}\n  {old}")
    with pytest.raises(InputError, match=f"is a second {word} record of surface"):
        read_zmx(saved(tmp_path, text), SENSOR)


def test_records_of_recent_versions_are_no_loss() -> None:
    result = read_zmx(IMPORTS / "new_records.zmx", SENSOR)
    assert (result.dropped, len(result.lens.surfaces)) == ((), 2)


NARROW = {
    "OBNA 0.1 0": 0.1,
    "OBNA 5.0 1": math.sin(math.radians(5.0)),
    "ENPD 8.0": math.sin(math.atan(4.0 / 60.0)),
    "FNUM 6.0 0": None,
    "FNUM 16.0 1": None,
}


@pytest.mark.parametrize(("record", "na"), NARROW.items())
def test_the_system_aperture_decides_what_rays_fill(tmp_path: Path, record: str, na: float | None) -> None:
    """The stop would let through 0.16; F-numbers by the thick lens's own first-order data."""
    result = read_zmx(saved(tmp_path, SINGLET.replace("OBNA 0.1 0", record)), SENSOR)
    lens = result.lens
    if na is None:
        cardinal = first_order(lens)
        efl, from_front = cardinal.efl_mm, -60.0 - cardinal.ffl_mm
        magnification = abs(efl / from_front)
        pupil = 0.5 * efl / 6.0
        tangent = pupil / 60.0 if record == "FNUM 6.0 0" else 0.5 / 16.0 * magnification
        na = math.sin(math.atan(tangent))
    assert lens.object.numerical_aperture == pytest.approx(na, rel=1e-9)
    semi = lens.stop_semi_diameter_mm
    sag = 50.0 - math.sqrt(50.0**2 - semi**2)
    assert semi / (60.0 + sag) == pytest.approx(math.tan(math.asin(na)), rel=1e-9)
    assert check_design(lens).numerical_aperture == pytest.approx(na, rel=1e-6)
    assert any("stop of 10 mm exceeds the system aperture" in r for r in result.remarks)
    assert result.first_order is not None
    assert result.first_order.stop_height_mm == pytest.approx(semi, rel=1e-9)


def test_the_footprint_behind_an_aperture_of_one_tenth() -> None:
    """On the axis, 50 mm behind; expected is Snell's law at two circles, done apart from the package."""
    from lensdesign.files.first_order_check import meridional_system

    lens = read_zmx(IMPORTS / "aperture_smaller_than_stop.zmx", SENSOR).lens
    ray = meridional_system(lens).trace(0.0, -60.0, 0.1)
    assert ray is not None
    assert ray.height_at(55.0) == pytest.approx(4.7243957, abs=1e-6)
    assert ray.heights_mm[0] == pytest.approx(lens.stop_semi_diameter_mm, rel=1e-12)


def test_a_stop_that_clips_the_system_aperture_stays(tmp_path: Path) -> None:
    result = read_zmx(saved(tmp_path, SINGLET.replace("OBNA 0.1", "OBNA 0.3")), SENSOR)
    assert (result.lens.stop_semi_diameter_mm, result.lens.object.numerical_aperture) == (10.0, 0.3)
    assert "at the stop, whose aperture of 10 mm clips it" in result.remarks[0]
    assert not check_design(result.lens).feasible


@pytest.mark.parametrize("flag", [1, 0])
def test_a_floating_stop_gives_the_numerical_aperture(tmp_path: Path, flag: int) -> None:
    text = SINGLET.replace("OBNA 0.1 0", "FLOA").replace("DIAM 10 1", f"DIAM 10 {flag}", 1)
    result = read_zmx(saved(tmp_path, text), SENSOR)
    sag = 50.0 - math.sqrt(50.0**2 - 10.0**2)
    na = math.sin(math.atan(10.0 / (60.0 + sag)))
    assert result.lens.stop_semi_diameter_mm == 10.0
    assert result.lens.object.numerical_aperture == pytest.approx(na, rel=1e-9)
    assert check_design(result.lens).numerical_aperture == pytest.approx(na, rel=1e-6)


def test_a_stop_within_the_lens_is_filled_by_the_real_marginal_ray(tmp_path: Path) -> None:
    text = SINGLET.replace("  STOP\n", "").replace("SURF 2\n", "SURF 2\n  STOP\n")
    lens = read_zmx(saved(tmp_path, text), SENSOR).lens
    assert lens.stop_index == 1
    assert check_design(lens).numerical_aperture == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize("second", ["ENPD 4", "FNUM 4 0", "FLOA", "OBNA 0.2 0"])
def test_two_system_apertures_are_refused(tmp_path: Path, second: str) -> None:
    text = SINGLET.replace("OBNA 0.1 0", f"OBNA 0.1 0\n{second}")
    with pytest.raises(
        InputError, match="line 6: a second system aperture that differs from the one of line 5"
    ):
        read_zmx(saved(tmp_path, text), SENSOR)


def test_automatic_semi_diameters_are_no_apertures(tmp_path: Path) -> None:
    """Flags 0 and 3 follow the rays, 1 is fixed, 2 is picked up; a clear aperture counts with any flag."""
    second = "  DISZ 50\n  DIAM 10 1 0 0 1"
    for flag, kept in ((0, None), (3, None), (1, 7.0), (2, 7.0)):
        result = read_zmx(
            saved(tmp_path, SINGLET.replace(second, f"  DISZ 50\n  DIAM 7 {flag} 0 0 1")), SENSOR
        )
        assert result.lens.surfaces[1].semi_diameter_mm == kept
        differences = any(
            "automatic semi-diameters do not clip" in r and "surface 2 7 mm" in r for r in result.remarks
        )
        assert differences == (kept is None)
    clear = read_zmx(
        saved(tmp_path, SINGLET.replace(second, "  DISZ 50\n  DIAM 7 0 0 0 1\n  CLAP 0 6 0")), SENSOR
    )
    assert clear.lens.surfaces[1].semi_diameter_mm == 6.0


def test_an_automatic_stop_is_as_wide_as_the_marginal_ray(tmp_path: Path) -> None:
    text = SINGLET.replace("DIAM 10 1", "DIAM 31.4 0", 1)
    lens = read_zmx(saved(tmp_path, text), SENSOR).lens
    assert check_design(lens).numerical_aperture == pytest.approx(0.1, rel=1e-6)


def test_the_users_catalogue_wins_over_the_makers(tmp_path: Path) -> None:
    melt = IMPORTS / "schott_melt.agf"
    text = (IMPORTS / "own_catalogue.zmx").read_text()
    own = Supplement(pixel_pitch_um=3.2, pixels=(1000, 1000), glass_catalogs=(melt,))
    for gcat in ("SCHOTT_MELT", "SCHOTT", "SCHOTT SCHOTT_MELT", "OHARA", "SCHOTT_MELT.AGF", "HOYA MISC"):
        result = read_zmx(saved(tmp_path, text.replace("SCHOTT_MELT", gcat)), own)
        assert result.lens.indices(0.532)[1] == pytest.approx(1.52075, abs=5e-6)
        assert "surface 1: glass N-BK7 is that of schott_melt.agf, not of Schott" in result.remarks
    schott = tmp_path / "schott.agf"
    schott.write_bytes(melt.read_bytes())
    two = Supplement(pixel_pitch_um=3.2, pixels=(1000, 1000), glass_catalogs=(schott,))
    assert read_zmx(saved(tmp_path, SINGLET), two).lens.indices(0.532)[1] == pytest.approx(1.52075, abs=5e-6)


def test_of_two_own_catalogues_the_one_that_the_file_names_comes_first(tmp_path: Path) -> None:
    one, two = tmp_path / "one.agf", tmp_path / "two.agf"
    one.write_text("NM N-BK7 5\nCD 1.6\nLD 0.3 2.5\n")
    two.write_text("NM N-BK7 5\nCD 1.7\nLD 0.3 2.5\n")
    own = Supplement(pixel_pitch_um=3.2, pixels=(1000, 1000), glass_catalogs=(one, two))
    for gcat, index in (("TWO", 1.7), ("ONE", 1.6), ("SCHOTT", 1.6), ("SCHOTT TWO ONE", 1.7)):
        result = read_zmx(saved(tmp_path, SINGLET.replace("GCAT SCHOTT", f"GCAT {gcat}")), own)
        assert result.lens.indices(0.532)[1] == index


def test_a_catalogue_that_is_not_at_hand_is_said(tmp_path: Path) -> None:
    result = read_zmx(IMPORTS / "own_catalogue.zmx", SENSOR)
    assert (
        "surface 1: glass N-BK7 is that of Schott; the file also names SCHOTT_MELT, which may have another "
        "of this "
        "name (give it as a glass catalogue)" in result.remarks
    )
    assert not any("also names" in r for r in read_zmx(saved(tmp_path, SINGLET), SENSOR).remarks)


def test_without_catalogues_a_former_glass_is_not_that_of_another_maker(tmp_path: Path) -> None:
    """CDGM has an F7 with another index than Schott's."""
    text = SINGLET.replace("GCAT SCHOTT", "NOTE 0 no catalogue").replace("N-BK7", "F7")
    with pytest.raises(MaterialError, match="glass 'F7' is known from CDGM alone"):
        read_zmx(saved(tmp_path, text), SENSOR)


def test_a_former_glass_of_schott_is_that_of_a_maker_whom_the_file_names_before(tmp_path: Path) -> None:
    for gcat, maker in (("LZOS SCHOTT", "LZOS:BK10"), ("SCHOTT LZOS", "N-BK10")):
        text = SINGLET.replace("GCAT SCHOTT", f"GCAT {gcat}").replace(RECORD, "BK10 0 0 1.5 40")
        assert read_zmx(saved(tmp_path, text), SENSOR).lens.surfaces[0].material in (
            maker,
            maker.split(":")[-1],
        )


def test_a_glass_of_an_own_catalogue_that_contradicts_itself_is_refused(tmp_path: Path) -> None:
    own = tmp_path / "own.agf"
    own.write_text(
        "NM N-BK7 2 0 1.5300 64\nCD 1.0396 0.0060007 0.23179 0.0200179 1.01047 103.56\nLD 0.35 2.5\n"
    )
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(1000, 1000), glass_catalogs=(own,))
    with pytest.raises(MaterialError, match=r"N-BK7 .*nd = 1\.5300.*\(CD\)"):
        read_zmx(saved(tmp_path, SINGLET), supplement)
    other = SINGLET.replace(RECORD, "F2 0 0 1.5 40")
    assert read_zmx(saved(tmp_path, other), supplement).lens.surfaces[0].material == "F2"


def test_the_lens_is_traced_and_compared_with_the_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The biconvex lens's textbook figures; and a reader that misreads is found out."""
    from lensdesign.files import zemax

    first = read_zmx(saved(tmp_path, SINGLET), SENSOR).first_order
    assert first is not None
    n = 1.5194726
    power = 2.0 * (n - 1.0) / 50.0 - (n - 1.0) ** 2 * 5.0 / (n * 50.0**2)
    assert first.efl_mm == pytest.approx(1.0 / power, rel=1e-7)
    assert first.bfl_mm == pytest.approx((1.0 - (n - 1.0) * 5.0 / (n * 50.0)) / power, rel=1e-7)
    principal = (n - 1.0) * 5.0 / (n * 50.0) / power
    assert first.magnification == pytest.approx(-1.0 / (power * (60.0 + principal) - 1.0), rel=1e-6)

    def misread(name: str, value: object) -> None:
        def take(reader: object, surface: zemax.FileSurface, values: list[str], location: str) -> None:
            setattr(surface, name, value)

        keyword = {"glass": "GLAS", "radius_mm": "CURV", "thickness_mm": "DISZ"}[name]
        with monkeypatch.context() as patched:
            patched.setitem(zemax._OF_SURFACE, keyword, take)
            with pytest.raises(InputError, match="disagrees with the file"):
                read_zmx(saved(tmp_path, SINGLET), SENSOR, lossy=True)

    misread("glass", ())
    misread("glass", ("F2",))
    misread("radius_mm", 49.9)
    misread("thickness_mm", 5.0)


def test_a_strong_asphere_near_the_axis_raises_no_alarm(tmp_path: Path) -> None:
    asphere = "TYPE EVENASPH\n  PARM 2 30.0\n  CURV 0\n  DIAM 0.05 1 0 0 1\n  DISZ 5"
    text = SINGLET.replace("TYPE STANDARD\n  CURV 0.02\n  DISZ 5", asphere).replace(
        "  DIAM 10 1 0 0 1\n", "", 1
    )
    result = read_zmx(saved(tmp_path, text.replace("OBNA 0.1", "OBNA 0.0008")), SENSOR)
    assert result.lens.surfaces[0].asphere == (30.0,)
    assert result.first_order is not None
    assert result.first_order.efl_mm == pytest.approx(50.0 / 0.5194726, rel=1e-6)


def test_coatings_are_omitted_with_a_remark(tmp_path: Path) -> None:
    found = read_zmx(saved(tmp_path, AC254_050.replace("STOP", "COAT AR\r\n  STOP", 1)), SUPPLEMENT)
    assert found.dropped == ()
    assert not any("apodization" in remark for remark in found.remarks)
    assert "surface 1: coating 'AR' omitted; it does not change the paths of rays" in found.remarks


@pytest.mark.parametrize(("unit", "unit_mm"), [("CM", 10.0), ("IN", 25.4), ("METER", 1000.0)])
def test_lengths_in_other_units_become_mm(tmp_path: Path, unit: str, unit_mm: float) -> None:
    """An asphere, its decenter and its object, in the unit and in mm: the same lens."""

    def text(mm_each: float, name: str) -> str:
        def unit_of(length_mm: float) -> str:
            return repr(length_mm / mm_each)

        front = (
            "TYPE EVENASPH",
            f"CURV {mm_each / 20.0!r}",
            "STOP",
            f"DISZ {unit_of(5.0)}",
            "GLAS N-BK7",
            f"DIAM {unit_of(4.0)} 1",
            f"PARM 2 {1e-5 * mm_each**3!r}",
            f"PARM 3 {1e-8 * mm_each**5!r}",
        )
        back = (f"CURV {mm_each / -30.0!r}", f"DISZ {unit_of(-5.0)}", f"DIAM {unit_of(4.5)} 1")
        shift = ("TYPE COORDBRK", f"PARM 1 {unit_of(0.5)}", "DISZ 0.0")
        unshift = ("TYPE COORDBRK", f"PARM 1 {unit_of(-0.5)}", "PARM 6 1", f"DISZ {unit_of(40.0)}")
        whole = zmx_text("unit", 1.0, D, [shift, front, back, unshift])
        return (
            whole.replace("UNIT MM", f"UNIT {name}")
            .replace("ENPD 1.0", f"ENPD {unit_of(6.0)}")
            .replace("FTYP 0 0 1", "FTYP 1 0 1")
            .replace("YFLN 0", f"YFLN {unit_of(2.0)}")
            .replace("DISZ INFINITY", f"DISZ {unit_of(100.0)}", 1)
        )

    sensor = Supplement(pixel_pitch_um=3.2, pixels=(1000, 800))
    expected = read_zmx(saved(tmp_path, text(1.0, "MM")), sensor)
    found = read_zmx(saved(tmp_path, text(unit_mm, unit)), sensor)
    assert f"lengths in {unit} converted to mm ({unit_mm:g} mm each)" in found.remarks
    assert found.pose.decenter_x_mm == pytest.approx(0.5, rel=1e-12)
    assert found.lens.object.field_diameter_mm == pytest.approx(4.0, rel=1e-12)
    for a, b in zip(found.lens.surfaces, expected.lens.surfaces, strict=True):
        assert a.radius_mm == pytest.approx(b.radius_mm, rel=1e-12)
        assert (a.thickness_mm or 0.0) == pytest.approx(b.thickness_mm or 0.0, rel=1e-12)
        assert a.semi_diameter_mm == pytest.approx(b.semi_diameter_mm, rel=1e-12)
        assert a.asphere == pytest.approx(b.asphere, rel=1e-12)
    assert found.lens.object.numerical_aperture == pytest.approx(
        expected.lens.object.numerical_aperture, rel=1e-9
    )


def test_a_quadratic_term_beside_a_paraboloid_is_part_of_its_curvature(tmp_path: Path) -> None:
    """Thorlabs' ACL3026 has c r^2 / 2 and 7.9e-6 r^2 with a conic constant of -1."""
    old = "CONI -0.6265"
    assert old in ACL2520
    text = ACL2520.replace(old, "CONI -1.0").replace("PARM 1 0", "PARM 1 7.9E-6", 1)
    found = read_zmx(saved(tmp_path, text), SUPPLEMENT)
    surface_1 = found.lens.surfaces[0]
    assert found.dropped == ()
    assert surface_1.conic == -1.0
    assert surface_1.radius_mm == pytest.approx(1.0 / (1.0 / 10.462 + 2.0 * 7.9e-6), rel=1e-14)
    r = 8.0
    sag = 0.5 * r**2 / 10.462 + 7.9e-6 * r**2 + 1.5e-5 * r**4
    assert float(surface_1.shape.sag(r, 0.0)) == pytest.approx(sag, rel=1e-13)


def test_a_quadratic_term_beside_another_conic_is_lost(tmp_path: Path) -> None:
    path = saved(tmp_path, ACL2520.replace("PARM 1 0", "PARM 1 7.9E-6", 1))
    with pytest.raises(LossyImportError, match=r"surface 1: asphere term in r\^2 of 7.9e-06"):
        read_zmx(path, SUPPLEMENT)


def test_cylinders_without_zernike_terms_are_read(tmp_path: Path) -> None:
    """Thorlabs' cylinders state the number of Zernike terms (0) and their radius of normalization."""
    extra = "TYPE TOROIDAL\r\n  XDAT 1 0.0 0 0\r\n  XDAT 2 1.0E+002 0 0\r\n  STOP"
    found = read_zmx(saved(tmp_path, AC254_050.replace("STOP", extra, 1)), SUPPLEMENT)
    assert found.lens.surfaces[0].shape.NAME == "toroid"
    assert found.dropped == ()


@pytest.mark.parametrize(("kind", "name", "conic"), [(0, "Qbfs", 0.0), (1, "Qcon", -0.7)])
def test_forbes_aspheres_are_read(tmp_path: Path, kind: int, name: str, conic: float) -> None:
    """The records are those of a lens of Thorlabs (ASL5040-UV)."""
    values = (kind, 3, 12.5, -2e-2, 1e-3, 5e-4)
    data = "".join(f'  XDAT {i} {v:.12E} 0 0 1.0E+00 0.0E+00 0 ""\r\n' for i, v in enumerate(values, 1))
    text = AC254_050.replace("STOP", f"TYPE QED_TYPE\r\n{data}  CONI {conic}\r\n  STOP", 1)
    found = read_zmx(saved(tmp_path, text), SUPPLEMENT)
    surface = found.lens.surfaces[0]
    assert found.dropped == ()
    assert (surface.shape.NAME, surface.normalization_radius_mm, surface.conic) == (name, 12.5, conic)
    assert surface.q_mm == values[3:]


def test_a_forbes_asphere_without_a_normalization_radius_is_refused(tmp_path: Path) -> None:
    text = AC254_050.replace("STOP", "TYPE QED_TYPE\r\n  XDAT 2 1\r\n  XDAT 4 1e-3\r\n  STOP", 1)
    with pytest.raises(InputError, match=r"a Forbes asphere has the normalization radius 0 \(XDAT 3\)"):
        read_zmx(saved(tmp_path, text), SUPPLEMENT)


def test_the_extra_data_of_a_published_qbfs_focus_its_light() -> None:
    """Rays of 405 nm through Thorlabs' ASL5040-UV, by a trace of its own, with a conic as base.

    Its axial distances, conic and terms are those of the vendor's file; the light is collimated.
    """
    curvature, conic, radius_mm = 5.756078762782423e-02, -0.67609120640407927, 27.0
    terms = (-8.148370167576e-01, -3.2311e-01, 1.0591e-01, -5.058e-02, 9.87e-03, -2.2e-03)
    index, thickness_mm, behind_mm = 1.46958, 29.85, 19.687453064998852  # fused silica (Malitson)
    departure = Surface(
        shape="Qbfs", radius_mm=None, normalization_radius_mm=radius_mm, q_mm=terms, semi_diameter_mm=22.8
    ).shape

    def sag(r: np.ndarray) -> np.ndarray:
        square = 1.0 - (1.0 + conic) * (curvature * r) ** 2
        cosine = np.sqrt(square / (square + (curvature * r) ** 2))
        return curvature * r**2 / (1.0 + np.sqrt(square)) + departure.sag(0.0 * r, r) / cosine

    r, step = np.linspace(1.0, 22.8, 12), 1e-4
    slope = (sag(r + step) - sag(r - step)) / (2.0 * step)
    angle = np.arctan(slope)  # of the normal, and of the incident ray to it
    direction = np.arcsin(np.sin(angle) / index) - angle
    at_back = r + (thickness_mm - sag(r)) * np.tan(direction)
    at_focus = at_back + behind_mm * np.tan(np.arcsin(index * np.sin(direction)))
    assert np.max(np.abs(at_focus)) < 1e-3


def test_a_radius_of_rotation_survives_the_rounding_of_its_curvature(tmp_path: Path) -> None:
    """1 / (1 / 100000) is not exactly 100000; that is no loss."""
    turned = 100000.0
    assert 1.0 / (1.0 / turned) != turned
    text = AC254_050.replace("STOP", f"TYPE TOROIDAL\r\n  PARM 1 {turned}\r\n  STOP", 1)
    found = read_zmx(saved(tmp_path, text), SUPPLEMENT)
    assert (found.dropped, found.lens.surfaces[0].radius_x_mm) == ((), turned)


@pytest.mark.parametrize("record", ["EDGE 1.0 3.0", "PKUP 2 1.0 0"])
def test_solves_of_the_distance_keep_its_present_value(tmp_path: Path, record: str) -> None:
    path = saved(tmp_path, AC254_050.replace("STOP", f"{record}\r\n  STOP", 1))
    found = read_zmx(path, SUPPLEMENT)
    assert f"surface 1: {record[:4]} solve or pickup replaced by its present value" in found.remarks
    assert found.dropped == ()


def test_the_data_of_an_unknown_surface_type_are_one_loss(tmp_path: Path) -> None:
    old = "TYPE GRINSUR1\r\n  PARM 1 0.5\r\n  XDAT 3 1.0\r\n  NSCS 1 15 _NONE_\r\n  STOP"
    path = saved(tmp_path, AC254_050.replace("STOP", old, 1))
    with pytest.raises(LossyImportError) as caught:
        read_zmx(path, SUPPLEMENT)
    assert caught.value.dropped == ("surface 1: surface type 'GRINSUR1' (gradient index), read as STANDARD",)


def test_records_of_old_versions_are_read(tmp_path: Path) -> None:
    """WAVN lists wavelengths, void behind those that FTYP counts; FEFD holds fields behind the twelfth."""
    text = AC254_050.replace("FTYP 0 0 1", "FTYP 1 0 14").replace("YFLN 0", "YFLN" + " 1.0" * 12)
    text = text.replace(
        "FWGN 1", "FWGN 1\r\nZVAN 0\r\nFENF 14 14\r\nFEFD 3 4 1 0 0 0 0 0\r\nFEFD 0 2 1 0 0 0 0 0"
    )
    listed = "\r\n".join(line for line in text.splitlines() if not line.startswith("WAVM"))
    listed = listed.replace("PWAV", "WAVN " + " ".join(map(repr, FDC)) + " 0.55" * 9 + "\r\nPWAV", 1)
    supplement = Supplement(working_distance_mm=100.0, pixel_pitch_um=3.2, pixels=(1000, 800))
    found = read_zmx(saved(tmp_path, listed), supplement)
    assert sorted(found.lens.wavelengths_um) == sorted(FDC)
    assert found.lens.object.field_diameter_mm == 10.0


def test_an_image_in_front_of_the_lens_is_no_sensor(tmp_path: Path) -> None:
    text = AC254_050.replace("DISZ 43.4", "DISZ -43.4")
    with pytest.raises(InputError, match=r"lacks plane_distances_mm \(its image lies -43.4 mm behind"):
        read_zmx(saved(tmp_path, text), SUPPLEMENT)


def test_mirrors_are_named_where_a_distance_is_negative(tmp_path: Path) -> None:
    text = AC254_050.replace("GLAS N-BAF10", "GLAS MIRROR").replace("DISZ 9.0", "DISZ -9.0")
    with pytest.raises(InputError, match=r"lies -9 mm behind surface 1; .* The file has mirrors: surface 1"):
        read_zmx(saved(tmp_path, text), SUPPLEMENT, lossy=True)


def test_an_apodization_is_omitted_with_a_remark(tmp_path: Path) -> None:
    found = read_zmx(saved(tmp_path, AC254_050.replace("GFAC 0 0", "GFAC 1 1")), SUPPLEMENT)
    assert "apodization of the pupil omitted; it does not change the paths of rays" in found.remarks
    assert found.dropped == ()


def test_an_unknown_glass_does_not_hide_a_gradient_index_or_a_mirror(tmp_path: Path) -> None:
    text = AC254_050.replace("STOP", "TYPE GRINSUR1\r\n  STOP", 1).replace("N-BAF10", "SLS-1.0")
    expected = (
        r"\(surface 1\): unknown material 'SLS-1.0'.* A design cannot represent these parts either: "
        r"surface 1: surface type 'GRINSUR1' \(gradient index\), read as STANDARD; surface 2: mirror"
    )
    with pytest.raises(MaterialError, match=expected):
        read_zmx(saved(tmp_path, text.replace("N-SF10", "MIRROR")), SUPPLEMENT)


def test_a_file_that_is_cut_short_is_refused_or_has_the_same_lens(tmp_path: Path) -> None:
    """Wherever the file ends, a reader never takes a surface of the lens for the image."""
    whole = read_zmx(saved(tmp_path, AC254_050), SUPPLEMENT).lens
    lines = AC254_050.split("\n")
    read = 0
    for count in range(1, len(lines)):
        try:
            found = read_zmx(saved(tmp_path, "\n".join(lines[:count])), SUPPLEMENT).lens
        except InputError:
            continue
        read += 1
        assert [s.radius_mm for s in found.surfaces] == [s.radius_mm for s in whole.surfaces]
        assert [s.material for s in found.surfaces] == [s.material for s in whole.surfaces]
    assert 0 < read < 20


@pytest.mark.parametrize(
    ("write", "read", "name"), [(write_zmx, read_zmx, "x.zmx"), (write_seq, read_seq, "x.seq")]
)
@pytest.mark.parametrize("pose", [Pose(), Pose(decenter_x_mm=0.1, tilt_y_deg=0.2, despace_mm=0.05)])
@pytest.mark.parametrize(("material", "distance"), [("N-BK7", 0.5), (1.51, 0.0)])
def test_a_cover_glass_is_written_as_two_planes_and_read_again(
    paper_lens, tmp_path, write, read, name, pose, material, distance
):
    glass = CoverGlass(thickness_mm=0.7, material=material, distance_mm=distance)
    sensor = paper_lens.sensor.replaced(cover_glass=glass, reflectance=0.1)
    lens = paper_lens.replaced(sensor=sensor)
    write(lens, tmp_path / name, pose)
    found = read(tmp_path / name)
    assert found.lens == lens
    assert found.pose == pose
    assert not found.dropped
    # Without the comments, as another program sees the file, the plate consists of surfaces.
    kind = "utf-16" if name == "x.zmx" else "utf-8"
    text = (tmp_path / name).read_bytes().decode(kind)
    kept = [line for line in text.splitlines() if "transferlens" not in line]
    (tmp_path / name).write_bytes("\n".join(kept).encode(kind))
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(9344, 7000), plane_distances_mm=(0.5,))
    if pose == Pose():
        surfaces = read(tmp_path / name, supplement).lens.surfaces
        assert [s.thickness_mm for s in surfaces[2:]] == [0.7, None]
        assert surfaces[1].thickness_mm == pytest.approx(2.0 - 0.7 - distance, abs=1e-12)
        assert surfaces[2].material == material


@pytest.mark.parametrize("reflectance", [0.0, 0.05, None])
def test_files_keep_the_reflectance_of_the_sensor(paper_lens, tmp_path, reflectance):
    lens = paper_lens.replaced(sensor=paper_lens.sensor.replaced(reflectance=reflectance))
    write_zmx(lens, tmp_path / "x.zmx")
    assert read_zmx(tmp_path / "x.zmx").lens.sensor.reflectance == reflectance


def test_an_edited_cover_glass_remains_in_the_lens(paper_lens, tmp_path):
    glass = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)
    lens = paper_lens.replaced(sensor=paper_lens.sensor.replaced(cover_glass=glass))
    write_zmx(lens, tmp_path / "x.zmx")
    text = (tmp_path / "x.zmx").read_bytes().decode("utf-16")
    assert text.count("DISZ 0.7") == 1
    (tmp_path / "x.zmx").write_bytes(text.replace("DISZ 0.7", "DISZ 0.9").encode("utf-16"))
    with pytest.raises(LossyImportError, match="cover glass of the sensor"):
        read_zmx(tmp_path / "x.zmx")


@pytest.mark.parametrize("catalog", [(), (IMPORTS / "vacuum.agf",)])
def test_a_vacuum_is_no_air(catalog: tuple[Path, ...]) -> None:
    """Lensmaker's equation with the index of N-BK7 relative to the vacuum around the lens."""
    n, radius, thickness = 1.5168000 / 0.999728, 50.0, 3.0
    power = (n - 1.0) * (2.0 / radius - (n - 1.0) * thickness / (n * radius**2))
    own = Supplement(pixel_pitch_um=3.2, pixels=(1000, 1000), glass_catalogs=catalog)
    found = read_zmx(IMPORTS / "lens_in_vacuum.zmx", own)
    assert found.first_order.efl_mm == pytest.approx(1.0 / power, rel=3e-5)
    assert round(found.first_order.efl_mm, 3) in (48.835, 48.836)
    assert len(found.lens.glass_fronts) == 1


def test_a_model_glass_may_be_a_vacuum(tmp_path: Path) -> None:
    text = (IMPORTS / "lens_in_vacuum.zmx").read_text()
    model = text.replace("VACUUM 0 0 0.999728 89.2", "___BLANK 1 0 0.999728 0")
    found = read_zmx(saved(tmp_path, model), SENSOR)
    assert found.lens.surfaces[0].material == 0.999728
    assert found.first_order.efl_mm == pytest.approx(48.8354, abs=1e-3)
    assert len(found.lens.glass_fronts) == 1
    with pytest.raises(InputError, match=r"0\.9"):
        read_zmx(saved(tmp_path, model.replace("0.999728", "0.95")), SENSOR)


def test_a_lens_in_a_vacuum_comes_back(tmp_path: Path) -> None:
    lens = read_zmx(IMPORTS / "lens_in_vacuum.zmx", SENSOR).lens
    write_zmx(lens, tmp_path / "again.zmx")
    assert read_zmx(tmp_path / "again.zmx").lens == lens


TILTED = (IMPORTS / "tilted_back.zmx").read_text()
PROPERTY = next(line for line in TILTED.splitlines() if "SCBD" in line)


def test_the_tilt_of_a_surface_is_a_loss_with_its_values(tmp_path: Path) -> None:
    with pytest.raises(LossyImportError) as caught:
        read_zmx(IMPORTS / "tilted_back.zmx", SENSOR)
    (loss,) = caught.value.dropped
    assert "surface 2" in loss
    assert "decenters 0, 0.5; tilts 2, 0, 0" in loss
    assert read_zmx(IMPORTS / "tilted_back.zmx", SENSOR, lossy=True).dropped == (loss,)


@pytest.mark.parametrize(
    "records",
    [
        "  SCBD 2 0 0 0 0.5 2 0 0",
        "  SCBD 1 1 0 0 0 0 0 0.5\n  SCBD 2 0 2 0 0 0 0 0",
        "  SCBD 2 0 2 0 0 0 0 0\n  SCBD 1 0 0 0.1 0 0 0 0",
        "  SCBD 1 0 3 0 0 0 0 0",
        "  SCBD 2 0 5 0 0 0 0 0",
        "  ROTA 1.0",
    ],
)
def test_no_record_that_moves_a_surface_is_dropped_in_silence(tmp_path: Path, records: str) -> None:
    path = saved(tmp_path, TILTED.replace(PROPERTY, records))
    with pytest.raises(LossyImportError, match="surface 2"):
        read_zmx(path, SENSOR)


@pytest.mark.parametrize("records", ["  SCBD 1 1 0 0 0 0 0 0\n  SCBD 2 0 2 0 0 0 0 0", "  ROTA 0 0"])
def test_a_tilt_of_zero_is_no_loss(tmp_path: Path, records: str) -> None:
    found = read_zmx(saved(tmp_path, TILTED.replace(PROPERTY, records)), SENSOR)
    assert (found.dropped, found.pose) == ((), Pose())


@pytest.mark.parametrize("axes", ["0.1 0.2 3.0 1.0 0.0", "-0.1 0.3 0.0 -2.0 0.0", "0.1 0.0 0.0 0.0 0.0"])
def test_surface_properties_put_the_lens_where_coordinate_breaks_do(tmp_path: Path, axes: str) -> None:
    """Axes that change at the first surface, and back at a plane behind a return to its vertex."""
    inverse = " ".join(f"{-float(v):g}" for v in axes.split())
    text = TILTED.replace(PROPERTY + "\n  DISZ 48", "  DISZ -3")
    plane = "SURF 3\n  TYPE STANDARD\n  CURV 0.0\n{records}  DISZ 51\nSURF 4\n"
    by_property = text.replace("  STOP\n", f"  STOP\n  SCBD 1 0 0 {axes}\n").replace(
        "SURF 3\n", plane.format(records=f"  SCBD 2 1 0 {inverse}\n")
    )
    breaks = [
        "  TYPE COORDBRK\n  CURV 0.0\n"
        + "".join(f"  PARM {i} {v}\n" for i, v in enumerate([*values.split(), str(order)], start=1))
        for order, values in enumerate((axes, inverse))
    ]
    by_breaks = text.replace("SURF 1\n", f"SURF 1\n{breaks[0]}  DISZ 0\nSURF 2\n", 1)
    by_breaks = by_breaks.replace("SURF 3\n", "SURF 4\n").replace("SURF 2\n  TYPE", "SURF 3\n  TYPE")
    by_breaks = by_breaks.replace("SURF 4\n", f"SURF 4\n{breaks[1]}  DISZ 51\nSURF 5\n")
    found = [read_zmx(saved(tmp_path, text), SENSOR) for text in (by_property, by_breaks)]
    assert found[0].pose == found[1].pose != Pose()
    assert found[0].lens == found[1].lens
    assert found[0].dropped == ()


def test_a_file_without_a_wavelength_has_that_of_a_new_lens(tmp_path: Path) -> None:
    found = read_zmx(IMPORTS / "no_wavm.zmx", SENSOR)
    assert found.lens.wavelengths_um == (0.55,)
    assert any("0.55" in remark for remark in found.remarks)
    text = (IMPORTS / "no_wavm.zmx").read_text().replace("YFLN 0.5", "YFLN 0.5\nWAVM 1 0.6328 1")
    assert read_zmx(saved(tmp_path, text), SENSOR).lens.wavelengths_um == (0.6328,)


def test_axes_in_front_of_the_object_move_nothing(tmp_path: Path) -> None:
    text = TILTED.replace(PROPERTY, "").replace("SURF 0\n", "SURF 0\n  SCBD 1 0 0 0.1 0.5 2 0 0\n")
    found = read_zmx(saved(tmp_path, text), SENSOR)
    assert (found.dropped, found.pose) == ((), Pose())
    with pytest.raises(LossyImportError, match="surface 0"):  # the object alone
        read_zmx(saved(tmp_path, text.replace("2 0 0\n", "2 0 0\n  SCBD 2 1 2 0 0 0 0 0\n")), SENSOR)
    with pytest.raises(LossyImportError, match="surface 3"):  # the image
        read_zmx(
            saved(tmp_path, TILTED.replace(PROPERTY, "").replace("SURF 3\n", f"SURF 3\n{PROPERTY}\n")), SENSOR
        )


def test_an_offset_of_the_index_is_a_loss(tmp_path: Path) -> None:
    text = SINGLET.replace(RECORD, "N-BK7 4 0 0.01 0.5")
    with pytest.raises(LossyImportError) as caught:
        read_zmx(saved(tmp_path, text), SENSOR)
    assert [loss[:30] for loss in caught.value.dropped] == ["surface 1: offset of the index"]
