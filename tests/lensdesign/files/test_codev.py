"""CODE V files: a prescription read as it is; designs back without loss; every refusal by name."""

from __future__ import annotations

import contextlib
import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import GOLDEN
from supplements import SENSOR, SUPPLEMENT

from lensdesign import InputError, Lens, MaterialError, Pose, scaled
from lensdesign.analysis.check import check_design
from lensdesign.analysis.paraxial import first_order
from lensdesign.files import codev
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.codev_glasses import coded_glass
from lensdesign.files.draft import LossyImportError, Supplement
from lensdesign.files.index_records import IndexRecord

# The textbook Cooke triplet of 50 mm focal length, f/5, as CODE V would save it.
COOKE = """RDM;LEN       "VERSION: 10.7       LENS VERSION: 80       Creation Date:  8-Sep-2020"
TITLE 'COOKE TRIPLET'
EPD   10.0
DIM   M
WL    650.0 550.0 480.0
REF   2
WTW   1 1 1
INI   '   '
XAN   0.0 0.0 0.0
YAN   0.0 14.0 20.0
WTF   1.0 1.0 1.0
VUX   0.0 0.0 0.0
VLY   0.0 &
      0.0 0.0
DOR   1.15 1.05
SO    0.0 0.1e14
S     22.01359 3.25896 SK16_HIKARI ; CIR 9.5
  CCY 0; THC 100
S     -435.76044 6.00755     ! the first air space
  SLB "L1"
S     -22.21328 0.99997 F2_SCHOTT
S     20.29192 4.75041
  STO
  CIR 5.0
S     79.68360 2.95208 SK16_HIKARI
S     -18.39533 42.20778
  PIM
SI    0.0 0.0
GO
"""
ASPHERE = """RDM
DIM M
NAO 0.1
WL 587.5618
YOB 0 2 4
SO 0 30
S 10.462 12.0 'NBK7_SCHOTT'
  ASP; K -0.6265
  A 1.5E-05; B 0.0; C -2.0D-10
  STO; CIR 10.0
S 0 20
SI 0 0
"""


def saved(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "lens.seq"
    path.write_text(text)
    return path


def test_a_textbook_triplet(tmp_path: Path) -> None:
    result = read_seq(saved(tmp_path, COOKE), SUPPLEMENT)
    lens = result.lens
    assert [s.radius_mm for s in lens.surfaces] == [
        22.01359,
        -435.76044,
        -22.21328,
        20.29192,
        79.6836,
        -18.39533,
    ]
    assert [s.thickness_mm for s in lens.surfaces] == [3.25896, 6.00755, 0.99997, 4.75041, 2.95208, None]
    assert [s.material for s in lens.surfaces] == ["SK16", None, "F2", None, "SK16", None]
    assert (lens.title, lens.stop_index, lens.wavelengths_um) == ("COOKE TRIPLET", 3, (0.55, 0.65, 0.48))
    assert first_order(lens).efl_mm == pytest.approx(50.0, abs=0.005)
    assert (result.dropped, result.pose) == ((), Pose())
    assert result.remarks == ("surface 6: PIM solve replaced by its present value",)


def test_an_asphere(tmp_path: Path) -> None:
    lens = read_seq(saved(tmp_path, ASPHERE), SENSOR).lens
    front = lens.surfaces[0]
    assert (front.conic, front.asphere) == (-0.6265, (1.5e-5, 0.0, -2e-10))
    assert front.semi_diameter_mm == pytest.approx(3.0606, abs=1e-4)  # of NA 0.1, in a stop of 10 mm
    assert (front.material, lens.object.field_diameter_mm, lens.object.numerical_aperture) == (
        "N-BK7",
        8.0,
        0.1,
    )
    assert lens.sensor.plane_distances_mm == (20.0,)


def test_curvatures_and_commands_of_single_values(tmp_path: Path) -> None:
    by_curvature = ASPHERE.replace("RDM", "RDM N").replace("S 10.462", "S 0.02")
    assert read_seq(saved(tmp_path, by_curvature), SENSOR).lens.surfaces[0].radius_mm == 50.0
    by_command = ASPHERE.replace("S 10.462 12.0 'NBK7_SCHOTT'", "S\nRDY 11.0\nTHI S1 13.0\nGLA NSF11_SCHOTT")
    front = read_seq(saved(tmp_path, by_command), SENSOR).lens.surfaces[0]
    assert (front.radius_mm, front.thickness_mm, front.material) == (11.0, 13.0, "N-SF11")
    other = ASPHERE.replace("STO;", "").replace("SI 0 0", "SI 0 0\nCUY S2 0.01\nSTO S1")
    lens = read_seq(saved(tmp_path, other), SENSOR).lens
    assert (lens.surfaces[1].radius_mm, lens.surfaces[0].stop) == (100.0, True)


APERTURES = {"NAO 0.1": 0.1, "EPD 20": math.sin(math.atan(10.0 / 30.0))}


@pytest.mark.parametrize(("command", "expected"), APERTURES.items())
def test_apertures_at_the_object(tmp_path: Path, command: str, expected: float) -> None:
    lens = read_seq(saved(tmp_path, ASPHERE.replace("NAO 0.1", command)), SENSOR).lens
    assert lens.object.numerical_aperture == pytest.approx(expected, rel=1e-12)


def test_apertures_at_the_image_are_one(tmp_path: Path) -> None:
    """F-number F and numerical aperture sin(atan(1 / 2F)) are the same cone."""
    na = math.sin(math.atan(0.5 / 4.0))
    found = [
        read_seq(saved(tmp_path, ASPHERE.replace("NAO 0.1", c)), SENSOR).lens.object.numerical_aperture
        for c in ("FNO 4.0", f"NA {na!r}")
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-12)


def test_decentered_surfaces_stand_where_the_pose_puts_them(tmp_path: Path, paper_lens: Lens) -> None:
    """Frames walked line by line: ADE and BDE turn left-handed, REV undoes behind its surface."""
    path = tmp_path / "lens.seq"
    pose = Pose(0.1, -0.2, 0.03, 1.5, -0.7, 4.4)
    write_seq(paper_lens, path, pose)
    frame, vertices = np.eye(4), []
    frame[2, 3] = paper_lens.object_z_mm
    surfaces = path.read_text().split("\nS")[1:]
    for block in surfaces:
        words = block.replace(";", " ").split()
        moves = {key: float(value) for key, value in pairwise(words) if key in MOVES}
        change = change_matrix(moves)
        if moves and "REV" not in words:
            frame = frame @ change
        vertices.append(frame.copy())
        if "REV" in words:
            frame = frame @ np.linalg.inv(change)
        step = np.eye(4)
        step[2, 3] = float(block.split()[2 if words[0] in "OI" else 1])
        frame = frame @ step
    rotation, shift = pose.transform()
    assert len(vertices) == 6
    for vertex, z in zip(vertices[2:4], paper_lens.vertex_z_mm, strict=True):
        np.testing.assert_allclose(vertex[:3, :3], rotation[0], atol=1e-14)
        np.testing.assert_allclose(vertex[:3, 3], rotation[0] @ [0.0, 0.0, z] + shift[0], atol=1e-13)
    image = np.eye(4)
    image[2, 3] = paper_lens.sensor_z_mm[0]
    np.testing.assert_allclose(vertices[-1], image, atol=1e-13)


MOVES = ("XDE", "YDE", "ADE", "BDE")


def change_matrix(moves: dict[str, float]) -> np.ndarray:
    """A plain decenter and tilt of CODE V."""
    result = np.eye(4)
    result[:2, 3] = moves.get("XDE", 0.0), moves.get("YDE", 0.0)
    a, b = np.deg2rad([moves.get("ADE", 0.0), moves.get("BDE", 0.0)])
    about_x, about_y = np.eye(4), np.eye(4)
    about_x[1:3, 1:3] = [[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]
    about_y[0, [0, 2]] = np.cos(b), -np.sin(b)
    about_y[2, [0, 2]] = np.sin(b), np.cos(b)
    return result @ about_x @ about_y


LOSSES = [
    ("F2_SCHOTT", "REFL", "surface 3: mirror"),
    ("F2_SCHOTT", "620364", r"surface 3: dispersion.* 620364"),
    ("F2_SCHOTT", "620040.363700", "surface 3: dispersion"),
    ("F2_SCHOTT", "1.62004:36.37", "surface 3: dispersion"),
    ("F2_SCHOTT", "'MINE'\nPRV\nPWL 650 550 480\n'MINE' 1.61 1.62 1.63\nEND", r"dispersion.*MINE"),
    ("CIR 5.0", "CIR 5.0; REX 5.0", "surface 4: rectangular aperture, 'REX 5.0'"),
    ("CIR 5.0", "CIR 5.0; CIR OBS 1.0", "surface 4: aperture CIR 'OBS 1.0'"),
    ("CIR 5.0", "CIR 5.0; XDE 0.1; DAR", "surface 4: coordinate break that is not a pose"),
    ("CIR 5.0", "CIR 5.0; ADE 45; BEN", "surface 4: BEN"),
    ("CIR 5.0", "CIR 5.0; DIF GRT", "surface 4: diffractive surface, 'DIF GRT'"),
    ("VUX   0.0", "VUX   0.1", "vignetting factors"),
    ("SI    0.0", "SI    99.0", "surface 7: curved image surface"),
    ("DOR", "ZOO 3; DOR", "line 15: zoom positions, 'ZOO 3'"),
    ("DOR", "TEM 40; DOR", "temperature of '40' degrees C"),
    ("DOR", "PRE 0; DOR", "pressure of '0' mmHg"),
]


@pytest.mark.parametrize(("old", "new", "message"), LOSSES)
def test_what_would_be_lost_is_listed(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in COOKE
    path = saved(tmp_path, COOKE.replace(old, new, 1))
    with pytest.raises(LossyImportError, match=message) as caught:
        read_seq(path, SUPPLEMENT)
    assert str(path) in str(caught.value)
    result = read_seq(path, SUPPLEMENT, lossy=True)
    assert result.dropped == caught.value.dropped
    if "62" in new:
        assert result.lens.surfaces[2].material == pytest.approx(1.62, abs=5e-5)


FAULTS = [
    ("DIM   M", "DIM   F", r"line 4: DIM 'F'; lengths must be in mm \(M\), cm \(C\) or inches \(I\)"),
    ("RDM;LEN", "LEN", "line 17: '22.01359' may be a radius or a curvature"),
    ("22.01359", "22.o1359", "line 17: '22.o1359' must be a finite number"),
    ("22.01359", "nan", "'nan' must be"),
    ("3.25896", "-3.0", "the next surface lies -3 mm behind surface 1"),
    ("SO ", "S ", "S as surface 0; the object"),
    ("SI    0.0 0.0\n", "", "no image surface"),
    ("GO", "S 1 2", "behind the image surface"),
    ("GO", "THI S99 3", "there is no surface 'S99' yet"),
    ("GO", "THI", "a command without its value"),
    ("GO", "PRV", "private glasses .* without END"),
    ("GO\n", "GO &", "the file ends within a command"),
    ("TITLE", "THI 3; TITLE", "a command of a surface before the first surface"),
    ("F2_SCHOTT", "XF2_SCHOTT", "unknown material 'XF2'"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in COOKE
    path = saved(tmp_path, COOKE.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        read_seq(path, SUPPLEMENT)
    assert str(caught.value).startswith(str(path))


def test_more_asphere_terms_than_the_format_holds_are_not_written(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.seq"
    with pytest.raises(InputError, match=r"10 asphere terms; a \.seq file holds 9, up to r\^20"):
        write_seq(paper_lens.with_surface(1, asphere=(*(0.0,) * 9, 1e-30)), path)
    assert not path.exists()


PRIVATE = (GOLDEN / "imports" / "unused_private_glass.seq").read_text()
NOA61 = "'GLUE1' LAU 2.36390625 0.0 0.025493134 -0.000580235 -0.349933e-5 0.445404e-7"


def test_an_unused_private_glass_is_passed_over() -> None:
    result = read_seq(GOLDEN / "imports" / "unused_private_glass.seq", SENSOR)
    assert [(s.radius_mm, s.material) for s in result.lens.surfaces] == [(50.0, "N-BK7"), (-50.0, None)]
    assert result.dropped == ()


@pytest.mark.parametrize(
    "glass",
    ["'GLUE1' HAR 1.5 0.004 0.12", "'GLUE1' XYZ 1 2", "'GLUE1'", "'GLUE1' 1.5 1.6", "GLUE1 nonsense , ;;"],
)
def test_what_cannot_be_read_of_a_private_glass_matters_where_it_is_used(tmp_path: Path, glass: str) -> None:
    line = next(x for x in PRIVATE.splitlines() if "GLUE1" in x)
    unused = PRIVATE.replace(line, f"  {glass}")
    assert len(read_seq(saved(tmp_path, unused), SENSOR).lens.surfaces) == 2
    with pytest.raises(InputError, match=r"line 10: .*'GLUE1'"):
        read_seq(saved(tmp_path, unused.replace("NBK7_SCHOTT", "'GLUE1'")), SENSOR)


def index_of(
    tmp_path: Path, glass: str, pwl: str = "550.0", wl: str = "587.5618", lossy: bool = False
) -> float:
    line = next(x for x in PRIVATE.splitlines() if "GLUE1" in x)
    text = PRIVATE.replace(line, f"  {glass}").replace("NBK7_SCHOTT", "'GLUE1'")
    text = text.replace("PWL 550.0", f"PWL {pwl}").replace("WL 587.6", f"WL {wl}", 1)
    return float(read_seq(saved(tmp_path, text), SENSOR, lossy).lens.indices(float(wl.split()[0]) / 1000)[1])


BK7 = "1.03961212 0.00600069867 0.231792344 0.0200179144 1.01046945 103.560653"


@pytest.mark.parametrize(
    ("glass", "index"),
    [
        (NOA61, 1.5597),  # Norland Optical Adhesive 61, n = 1.56 after curing
        (f"'GLUE1' GMS {BK7}", 1.5168),
        (f"glue1 gms {BK7}", 1.5168),
        ("'GLUE1' LAU 2.2718929 -0.010108077 0.010592509 0.00020816965 -7.6472538E-06 4.9240991E-07", 1.5168),
        ("'GLUE1' GML 2.2718929 -0.010108077 0.010592509 0.00020816965 -7.6472538E-06 4.9240991E-07", 1.5168),
        ("'GLUE1' CAU 1.5046 0.0042", 1.516766),
    ],
)
def test_private_glasses_by_formulas(tmp_path: Path, glass: str, index: float) -> None:
    assert index_of(tmp_path, glass) == pytest.approx(index, abs=5e-5)
    with pytest.raises(LossyImportError, match="surface 1: dispersion"):
        index_of(tmp_path, glass, wl="587.5618 486.1 656.3")
    assert index_of(tmp_path, glass, wl="587.5618 486.1 656.3", lossy=True) == pytest.approx(index, abs=5e-5)


@pytest.mark.parametrize(
    ("glass", "message"),
    [
        ("'GLUE1' LAU -2.0", r"Laurent.*'GLUE1'.* nan"),
        ("'GLUE1' GMS 1.0 0.3452288", "give an index of"),
        ("'GLUE1' CAU 0.5", r"index of 0.5 at 0.587562 µm"),
        ("'GLUE1' CAU 1.5 0.1 0.1 0.1", r"4 Cauchy.*1 to 3"),
        ("'GLUE1' LAU", "has 0 Laurent coefficients"),
        ("'GLUE1' LAU 2.3 X", "'X' must be a finite number"),
    ],
)
def test_private_glasses_without_an_index_are_named(tmp_path: Path, glass: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        index_of(tmp_path, glass)


def test_private_glasses_by_tables(tmp_path: Path) -> None:
    """At a wavelength of the table, between, and outside, where the nearest index is a loss."""
    table, pwl = "'GLUE1' 1.51432 1.51680 1.52238 1.52668", "656.2725 587.5618 486.1327 435.8343"
    assert index_of(tmp_path, table, pwl, lossy=True) == 1.5168
    assert index_of(tmp_path, table, pwl, "532.0", lossy=True) == pytest.approx(1.51947, abs=2e-5)
    with pytest.raises(LossyImportError, match=r"GLUE1 .*700 nm.*656\.273 nm"):
        index_of(tmp_path, table, pwl, "700.0")
    with pytest.raises(LossyImportError, match=r"GLUE1 .*700 nm.*550 nm"):
        index_of(tmp_path, "'GLUE1' 1.5", "550.0", "700.0")
    assert index_of(tmp_path, "'GLUE1' 1.5", "587.6") == 1.5


SOLVES = [
    ("S -50 50\n", "S -50 50\n THI HMY 0.0\n", "surface 2: HMY solve replaced by its present value"),
    ("S -50 50\n", "S -50 50\n THI S2 HMY 0.0\n", "surface 2: HMY solve replaced by its present value"),
    ("S -50 50\n", "S -50 50\n PIM\n", "surface 2: PIM solve replaced by its present value"),
    ("S -50 50\n", "S -50 50\n CUY UMY -0.1\n", "surface 2: UMY solve replaced by its present value"),
    ("S -50 50\n", "S -50 50\n CUY SOL UMY -0.1\n", "surface 2: SOL solve replaced by its present value"),
    ("S -50 50\n", "S -50 50\n RDY PIK S1 -1\n", "surface 2: PIK solve replaced by its present value"),
    ("S -50 50\n", "S -50 HMY\n THI 50\n", "surface 2: HMY solve replaced by its present value"),
    ("S -50 50\n", "S UMY -0.1\n RDY -50\n THI 50\n", None),
]


@pytest.mark.parametrize(("old", "new", "remark"), SOLVES)
def test_solves_leave_the_present_value(tmp_path: Path, old: str, new: str, remark: str | None) -> None:
    assert old in PRIVATE
    path = saved(tmp_path, PRIVATE.replace(old, new))
    if remark is None:  # UMY's own value stands where the thickness does; the thickness that follows counts
        assert read_seq(path, SENSOR).lens.sensor.plane_distances_mm == (50.0,)
        return
    result = read_seq(path, SENSOR)
    assert remark in result.remarks
    assert [s.radius_mm for s in result.lens.surfaces] == [50.0, -50.0]
    assert result.lens.sensor.plane_distances_mm == (50.0,)


@pytest.mark.parametrize(
    ("new", "message"),
    [
        ("S -50 HMY 0\n", r"line 16: the thickness of surface 2 is defined by a solve or pickup \('HMY 0'\)"),
        (
            "S -50\n THI HMY 0.0\n",
            r"the thickness of surface 2 is defined by a solve or pickup \('HMY 0.0'\)",
        ),
        ("S UMY 50\n", "the radius of surface 2 is defined by a solve or pickup"),
        ("S -50 FOO\n", "line 16: 'FOO' must be a finite number"),
    ],
)
def test_solves_without_a_present_value_are_named(tmp_path: Path, new: str, message: str) -> None:
    path = saved(tmp_path, PRIVATE.replace("S -50 50\n", new))
    for lossy in (False, True):
        with pytest.raises(InputError, match=message):
            read_seq(path, SENSOR, lossy)


@pytest.mark.parametrize("command", ["THI EDG 0.5", "THI VAR", "CUY FOO 1", "RDY S2 ABC"])
def test_an_unknown_word_in_place_of_a_value_that_is_known_is_a_loss(tmp_path: Path, command: str) -> None:
    path = saved(tmp_path, PRIVATE.replace("S -50 50\n", f"S -50 50\n {command}\n"))
    with pytest.raises(LossyImportError, match=r"surface 2: (thickness|radius) by '[A-Z .05]+1?'"):
        read_seq(path, SENSOR)
    lens = read_seq(path, SENSOR, lossy=True).lens
    assert (lens.surfaces[1].radius_mm, lens.sensor.plane_distances_mm) == (-50.0, (50.0,))


def test_words_of_more_than_three_letters_and_infinity(tmp_path: Path) -> None:
    text = PRIVATE.replace(" STO\n", " STOP\n").replace("S -50 50", "S INF 50").replace("S 50 5", "s 50 5")
    lens = read_seq(saved(tmp_path, text), SENSOR).lens
    assert [(s.radius_mm, s.stop) for s in lens.surfaces] == [(50.0, True), (None, False)]
    far = Supplement(working_distance_mm=60.0, pixel_pitch_um=3.2, pixels=(10, 10))
    assert read_seq(saved(tmp_path, PRIVATE.replace("SO 0 60", "SO INFINITY INFINITY")), far).lens == (
        read_seq(saved(tmp_path, PRIVATE), far).lens
    )


@pytest.mark.parametrize("command", ["NAO 0.1", "EPD 12.0", "FNO 16", "NA 0.03"])
def test_the_system_aperture_decides_what_rays_fill(tmp_path: Path, command: str) -> None:
    result = read_seq(saved(tmp_path, PRIVATE.replace("NAO 0.1", command)), SENSOR)
    lens = result.lens
    assert lens.stop_semi_diameter_mm < 10.0
    assert check_design(lens).numerical_aperture == pytest.approx(lens.object.numerical_aperture, rel=1e-6)
    assert "exceeds the system aperture" in result.remarks[0]


def test_the_users_catalogue_wins_over_the_maker_that_the_file_names() -> None:
    own = Supplement(
        pixel_pitch_um=3.2, pixels=(10, 10), glass_catalogs=(GOLDEN / "imports" / "schott_melt.agf",)
    )
    result = read_seq(GOLDEN / "imports" / "unused_private_glass.seq", own)
    assert result.lens.indices(0.532)[1] == pytest.approx(1.52075, abs=5e-6)
    assert "surface 1: glass NBK7 is that of schott_melt.agf, not of Schott" in result.remarks


@pytest.mark.parametrize(
    ("name", "index"), [("BAF4", 1.60562), ("F2", 1.62004), ("SK16", 1.62041), ("HK9L", 1.5168)]
)
def test_names_without_a_maker_are_those_of_schott(tmp_path: Path, name: str, index: float) -> None:
    """Indices at the d line by Schott's old catalogues; CDGM uses some of these names otherwise."""
    result = read_seq(saved(tmp_path, ASPHERE.replace("'NBK7_SCHOTT'", name)), SENSOR)
    assert result.lens.indices(0.5875618)[1] == pytest.approx(index, abs=2e-5)
    assert any("does not name the catalogue" in remark for remark in result.remarks)


def test_names_that_only_other_makers_use_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MaterialError, match="known from CDGM alone"):
        read_seq(saved(tmp_path, ASPHERE.replace("'NBK7_SCHOTT'", "F7")), SENSOR)
    named = read_seq(saved(tmp_path, ASPHERE.replace("'NBK7_SCHOTT'", "F7_CDGM")), SENSOR)
    assert named.lens.indices(0.5875618)[1] == pytest.approx(1.636, abs=1e-3)


@pytest.mark.parametrize(("unit", "unit_mm"), [("C", 10.0), ("I", 25.4)])
def test_lengths_in_other_units_become_mm(
    tmp_path: Path, paper_lens: Lens, unit: str, unit_mm: float
) -> None:
    """Every length of the file is multiplied, the aperture angle and the wavelengths are not."""
    write_seq(paper_lens, tmp_path / "mm.seq", Pose(decenter_y_mm=0.1))
    text = (tmp_path / "mm.seq").read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith("! transferlens")]
    path = saved(tmp_path, "\n".join(kept).replace("DIM M", f"DIM {unit}"))
    found = read_seq(path, Supplement(pixel_pitch_um=3.2, pixels=(1000, 800)))
    assert f"lengths in {unit} converted to mm ({unit_mm:g} mm each)" in found.remarks
    assert found.pose.decenter_y_mm == pytest.approx(0.1 * unit_mm)
    assert found.lens.wavelengths_um == paper_lens.wavelengths_um
    assert found.lens.object.numerical_aperture == paper_lens.object.numerical_aperture
    assert found.lens.object.field_diameter_mm == pytest.approx(unit_mm * paper_lens.object.field_diameter_mm)
    for surface, one in zip(found.lens.surfaces, scaled(paper_lens, unit_mm).surfaces, strict=True):
        assert surface.radius_mm == pytest.approx(one.radius_mm, rel=1e-13)
        assert surface.asphere == pytest.approx(one.asphere, rel=1e-13)
        assert (surface.thickness_mm or 0.0) == pytest.approx(one.thickness_mm or 0.0, rel=1e-13)
        assert surface.semi_diameter_mm == pytest.approx(one.semi_diameter_mm, rel=1e-13)


IMPORTS = GOLDEN / "imports"


def test_a_model_glass_of_two_words_is_index_and_abbe_number() -> None:
    """The lensmaker's equation with n = 1.5168: f = 49.213 mm, exact at the only wavelength, the d line."""
    result = read_seq(IMPORTS / "nd_vd.seq", SUPPLEMENT)
    assert (result.lens.surfaces[0].material, result.dropped) == (1.5168, ())
    power = 0.5168 * (2.0 / 50.0 - 0.5168 * 5.0 / (1.5168 * 50.0**2))
    assert result.first_order is not None
    assert result.first_order.efl_mm == pytest.approx(1.0 / power, rel=1e-9)


@pytest.mark.parametrize(
    ("words", "index"),
    [
        ("517642", 1.517),
        ("517.642", 1.517),
        ("516800.641700", 1.5168),
        ("1.5168:64.17", 1.5168),
        ("1.5168 64.17", 1.5168),
        ("'1.5168:64.17'", 1.5168),
        ("2.022 29.1", 2.022),
    ],
)
def test_every_form_of_a_glass_code_has_the_index_it_states(tmp_path: Path, words: str, index: float) -> None:
    text = ASPHERE.replace("'NBK7_SCHOTT'", words)
    for stated in (text, text.replace(f" {words}\n", f"\n  GLA S1 {words}\n")):
        result = read_seq(saved(tmp_path, stated), SENSOR)
        assert result.lens.surfaces[0].material == pytest.approx(index, abs=1e-12)
        assert result.dropped == ()
        for wavelengths in ("550", "587.5618 486.1 656.3"):
            with pytest.raises(LossyImportError, match="surface 1: dispersion of the model glass"):
                read_seq(saved(tmp_path, stated.replace("WL 587.5618", f"WL {wavelengths}")), SENSOR)


@pytest.mark.parametrize(
    "words", ["51764", "5176420", "1.5168", "0.5168:64", "64.17:1.5", "022291", "517642."]
)
def test_a_number_that_is_no_glass_code_is_refused(tmp_path: Path, words: str) -> None:
    with pytest.raises(InputError, match=r"line 7 \(surface 1\): .*(no glass code|allowed are)"):
        read_seq(saved(tmp_path, ASPHERE.replace("'NBK7_SCHOTT'", words)), SENSOR, lossy=True)


def test_the_thickness_of_the_image_surface_moves_the_sensor(tmp_path: Path) -> None:
    result = read_seq(IMPORTS / "focus_shift.seq", SENSOR)
    assert result.lens.sensor.plane_distances_mm == (pytest.approx(63.1717, abs=1e-12),)
    assert result.dropped == ()
    text = (IMPORTS / "focus_shift.seq").read_text()
    for other in ("SI 0 0\nTHI SI -0.25\n", "SI 0 0\nTHI -0.25\n"):
        found = read_seq(saved(tmp_path, text.replace("SI    0.0 -0.25\n", other)), SENSOR)
        assert found.lens == result.lens
    inches = read_seq(saved(tmp_path, text.replace("DIM   M", "DIM I")), SENSOR).lens
    assert inches.sensor.plane_distances_mm == (pytest.approx(25.4 * 63.1717, rel=1e-12),)


def test_the_focus_shift_of_a_tilted_lens_moves_the_sensor_alone(tmp_path: Path, paper_lens: Lens) -> None:
    pose = Pose(decenter_y_mm=0.1, tilt_x_deg=0.5, pivot_z_mm=4.0)
    path = tmp_path / "pose.seq"
    write_seq(paper_lens, path, pose)
    path.write_text(path.read_text().replace("SI 0.0 0.0", "SI 0.0 0.5"))
    result = read_seq(path, lossy=True)
    assert result.pose == pose
    planes = (paper_lens.sensor.plane_distances_mm[0], result.lens.sensor.plane_distances_mm[0])
    assert planes[1] - planes[0] == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize("name", ["uid.seq", "tolerances.seq"])
def test_identifiers_and_tolerances_change_nothing(tmp_path: Path, name: str) -> None:
    lines = (IMPORTS / name).read_text().splitlines()
    kept = [line for line in lines if line[:3] not in ("UID", "DLF", "DLR", "TIR")]
    assert len(kept) < len(lines)
    assert read_seq(IMPORTS / name, SUPPLEMENT) == read_seq(saved(tmp_path, "\n".join(kept)), SUPPLEMENT)


@pytest.mark.parametrize(
    "command",
    [
        "DLF S1 0.5; DLR SA 0.02; DLC S1 1e-5; DLT S1..2 0.02; DLN S1 0.0005; DLV S1 0.008; DLS S1 0.01",
        "DLX S1 0.01; DLY S1 0.01; DLZ S1 0.01; DSX S1..2 0.01; DSY S1..2 0.01; DSZ S1..2 0.01",
        "TIR S1 0.01; IRR S1 0.5; CYN S1 0.5; CYD S1 0.5; TRX S1 0.01; BTX S1..2 0.001; BTY S1..2 0.001",
        "ROL S1..2 0.01; TIL S1..2 0.001; DIS S1..2 0.01; RSE S1 0.05; CMP DLZ SI 1.0",
        "SLB \"front\"; COM 'a; comment'; CLS WVL RUS GRE BLU; CUM 0.0; THM 1.0; PUI 0.135; TEL N; POL N",
        "CIR EDG 12; REX EDG 12; REY EDG 12; ADY EDG 1",
        "THI S2 OAL S1..2 32.0",
    ],
)
def test_commands_that_do_not_describe_the_nominal_lens_are_ignored(tmp_path: Path, command: str) -> None:
    plain = read_seq(saved(tmp_path, ASPHERE), SENSOR)
    result = read_seq(saved(tmp_path, ASPHERE + command + "\n"), SENSOR)
    assert (result.lens, result.dropped) == (plain.lens, ())


@pytest.mark.parametrize(
    ("old", "new", "loss"),
    [
        ("'NBK7_SCHOTT'", "NBK7_SCHOTT REFL", "surface 1: mirror"),
        ("'NBK7_SCHOTT'", "MIRROR", "surface 1: mirror"),
        ("'NBK7_SCHOTT'", "NBK7_SCHOTT TIRO", "surface 1: 'TIRO' behind the glass"),
        ("'NBK7_SCHOTT'", "1.5168 64.17 0.01", "surface 1: '0.01' behind the glass"),
        ("'NBK7_SCHOTT'", "NBK7_SCHOTT\n RMD TIRO", "surface 1: reflection or total reflection, 'RMD TIRO'"),
        ("'NBK7_SCHOTT'", "NBK7_SCHOTT\n TIRO", "reflection or total reflection, 'TIRO'"),
        ("NAO 0.1", "NAO 0.1 0.2", "'0.2' behind the value of the system aperture"),
        ("K -0.6265", "K -0.6265 3", "surface 1: '3' behind the value of K"),
        ("NAO 0.1", "NAO 0.1; TEL Y", "telecentric or afocal system, 'TEL Y'"),
        ("SI 0 0", "SI 0 0\nDEF 0.1", "surface 3: 'DEF 0.1'"),
    ],
)
def test_words_that_change_the_lens_are_losses(tmp_path: Path, old: str, new: str, loss: str) -> None:
    assert old in ASPHERE
    with pytest.raises(LossyImportError, match=loss):
        read_seq(saved(tmp_path, ASPHERE.replace(old, new)), SENSOR)


@pytest.mark.parametrize(
    ("command", "radii"),
    [
        ("RDY S2 80", (10.462, 80.0)),
        ("RDY SI-1 80", (10.462, 80.0)),
        ("RDY SS+1 80", (10.462, 80.0)),
        ("RDY S1..2 80", (80.0, 80.0)),
        ("RDY S1..SI-1 80", (80.0, 80.0)),
    ],
)
def test_commands_name_their_surfaces(tmp_path: Path, command: str, radii: tuple[float, ...]) -> None:
    lens = read_seq(saved(tmp_path, f"{ASPHERE}{command}\n"), SENSOR).lens
    assert tuple(s.radius_mm for s in lens.surfaces) == radii


@pytest.mark.parametrize(
    "command", ["RDY S9 80", "RDY S1..9 80", "RDY S2..1 80", "RDY SI+1 80", "RDY S1.. 80"]
)
def test_surfaces_that_do_not_exist_are_refused(tmp_path: Path, command: str) -> None:
    with pytest.raises(InputError, match=r"line 13: (there is no surface|'S1\.\.' must be)"):
        read_seq(saved(tmp_path, f"{ASPHERE}{command}\n"), SENSOR)


def test_letters_without_asp_have_a_remark(tmp_path: Path) -> None:
    """Other programs write none, and mean other powers."""
    plain = read_seq(saved(tmp_path, ASPHERE), SENSOR)
    assert not any("without ASP" in remark for remark in plain.remarks)
    result = read_seq(saved(tmp_path, ASPHERE.replace("ASP; ", "")), SENSOR)
    assert result.lens == plain.lens
    assert any("surface 1: its coefficients without ASP" in remark for remark in result.remarks)


@pytest.mark.parametrize("title", ["", "''", "\t"])
def test_no_title_is_written_if_there_is_none(tmp_path: Path, paper_lens: Lens, title: str) -> None:
    path = tmp_path / "untitled.seq"
    lens = paper_lens.replaced(title=title)
    write_seq(lens, path)
    assert "TITLE" not in path.read_text()
    assert read_seq(path).lens == lens


def test_a_decenter_that_returns_at_the_last_vertex_is_that_which_returns_at_the_first(
    tmp_path: Path,
) -> None:
    """The same as a decenter of every surface by itself (DAR)."""
    lens = "S 50 5 NBK7_SCHOTT\n{0}\nSTO\nS -50 {1}\n{0}\n"
    head = "RDM; DIM M; NAO 0.02; WL 587.6; YOB 0 0.5; SO 0 100\n"
    dummy, end = "S 0 0; XDE 0.1; YDE -0.3\n", "SI 0 0\n"
    texts = [
        head + dummy + lens.format("", -5) + "S 0 68; XDE 0.1; YDE -0.3; REV\n" + end,
        head + dummy + lens.format("", 0) + "S 0 63; XDE 0.1; YDE -0.3; REV\n" + end,
        head + dummy + lens.format("", 60) + "S 0 3; XDE -0.1; YDE 0.3\n" + end,
        head + lens.format("XDE 0.1; YDE -0.3; DAR", 63) + end,
    ]
    found = [read_seq(saved(tmp_path, text), SENSOR) for text in texts]
    for result in found:
        assert (result.pose.decenter_x_mm, result.pose.decenter_y_mm) == (0.1, -0.3)
        assert result.dropped == ()
        assert (result.lens, result.pose) == (found[0].lens, found[0].pose)


def test_names_of_private_glasses_name_no_catalogue(tmp_path: Path, paper_lens: Lens) -> None:
    """Other programs take what follows an underscore for a catalogue; files of older versions have one."""
    path = tmp_path / "index.seq"
    lens = paper_lens.with_surface(1, material=1.6)
    write_seq(lens, path)
    names = [line.split()[0] for line in path.read_text().splitlines() if line.startswith("'TRANSFERLENS")]
    assert len(names) == 1
    assert "_" not in names[0]
    assert read_seq(path).lens == lens
    path.write_text(path.read_text().replace("TRANSFERLENS", "TRANSFERLENS_"))
    assert read_seq(path).lens == lens


@pytest.mark.parametrize("code", ["517642", "516800.641700", "1.5168:64.17", "1.5168 64.17"])
def test_a_misread_glass_code_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """The check of the import reads the code a second time."""
    text = (
        "RDM;LEN\nDIM M\nWL 587.5618\nNAO 0.02\nYOB 0 1\nSO 0 100\nS 50 3 "
        + code
        + "\nSTO\nS -50 60\nSI 0 0\n"
    )
    path = tmp_path / "lens.seq"
    path.write_text(text)
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(100, 100))
    assert read_seq(path, supplement).lens.surfaces[0].material == pytest.approx(1.5168, abs=3e-4)

    def misread(token: str, location: str) -> IndexRecord | None:
        found = coded_glass(token, location)
        return None if found is None else IndexRecord(1.1, found.vd)

    monkeypatch.setattr(codev, "coded_glass", misread)
    with pytest.raises(InputError, match=r"index of 1\.1 was read .* 1\.51"):
        read_seq(path, supplement)


WORDS = st.sampled_from(
    re.split(
        " +",
        "S SO SI THI RDY GLA K A ASP STO CIR XDE ADE REV DAR ZOO SA SS SI-1 S1..2 S9 1.5168 64.17 517642 "
        "1.5:60 REFL PIM HMY OAL 0 1e308 -1e308 1e-308 5 -5 INF 'x' PRV END PWL WL REF 0.1 EPD FNO NA DIM I "
        "UID DLF EDG & ; ! \" '",
    )
)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    changes=st.lists(st.tuples(st.integers(0, 60), WORDS, st.booleans()), min_size=1, max_size=4),
    lossy=st.booleans(),
)
def test_damaged_files_give_a_lens_or_a_message(
    tmp_path: Path, changes: list[tuple[int, str, bool]], lossy: bool
) -> None:
    """Words are replaced or inserted anywhere."""
    words = ASPHERE.replace("\n", " \n ").split(" ")
    for place, word, is_new in changes:
        at = place % len(words)
        words[at : at if is_new else at + 1] = [word]
    path = saved(tmp_path, " ".join(words))
    with contextlib.suppress(InputError, MaterialError):
        lens = read_seq(path, SUPPLEMENT, lossy).lens
        assert np.isfinite(lens.indices(lens.wavelengths_um[0])).all()
