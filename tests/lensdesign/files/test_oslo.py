"""OSLO files: surfaces, glasses and apertures as OSLO means them; solves evaluated; every refusal by name."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from places import GOLDEN
from random_lenses import lenses
from supplements import SENSOR

from lensdesign import InputError, Lens, MaterialError, Pose
from lensdesign.analysis.paraxial import first_order
from lensdesign.files.assembly import fold_dummy_planes
from lensdesign.files.draft import Imported, LossyImportError, Supplement, SurfaceRow
from lensdesign.files.oslo import read_len
from lensdesign.lens.shapes.even_asphere import without_zeros
from lensdesign.raytrace.bundles import launch, pupil_hexapolar
from lensdesign.raytrace.rays import trace

# The form in which OSLO 6.6 saves a lens: a finite object, model glass, checked and unchecked apertures.
SAVED = """// OSLO 6.6 58447     0     0
LEN NEW "Relay; 1:1 // first" 100 5
NAO  0.05
OBH  -10.0
DES  "OSLO"
UNI  1.0
SNO1 "A note; with a semicolon"
// SRF 0
AIR
TH   200.0
AP  10.0
NXT  // SRF 1
GLA N-BK7
RD   110.0
TH   8.0
AP CHK 0.0
NXT  // SRF 2
WV 0.58756 0.48613 0.65627
GLA MOD MODEL1      1.6201 1.6272360458395 1.6169694895481
TCE  236.0
RD   -95.0
TH   4.0
AP CHK 14.5
NXT  // SRF 3
AIR
RD   -300.0
TH   10.0
NXT  // SRF 4
AIR
TH   190.0
AST
AP  12.5
NXT  // SRF 5
AIR
WV 0.58756
WW 1.0
END  5
"""

# The form of OSLO 5 with solves and pickups in the place of radii and thicknesses, and an object at infinity.
DOUBLET = """// OSLO 5.00 31567     0     0
LEN NEW "He-Ne doublet" 60 5
EBR  15.0
ANG  0.0000572957795
DES  "OSLO"
UNI  1.0
AIR
TH   1.0e+20
AP  9.9999999977e+13
NXT
GLA LASF35
RD   100.0
TH   5.0
NXT
AIR
TH   1.0
NXT
PK  GLA  -2
RD   50.0
PK  TH -2
NXT
AIR
PU   -0.25
PY   0.0
NXT
AIR
WV 0.6328
WW 1.0
END  5
"""
FAR = Supplement(working_distance_mm=500.0, field_diameter_mm=1.0, pixel_pitch_um=3.2, pixels=(1000, 800))


def saved(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "lens.len"
    path.write_text(text)
    return path


def read(
    tmp_path: Path, text: str, old: str = "", new: str = "", lossy: bool = False, far: bool = False
) -> Imported:
    assert old in text
    return read_len(saved(tmp_path, text.replace(old, new, 1)), FAR if far else SENSOR, lossy)


def test_a_file_as_oslo_saves_it(tmp_path: Path) -> None:
    result = read(tmp_path, SAVED)
    lens = result.lens
    assert lens.title == "Relay; 1:1 // first"
    assert [s.radius_mm for s in lens.surfaces] == [110.0, -95.0, -300.0, None]
    assert [s.thickness_mm for s in lens.surfaces] == [8.0, 4.0, 10.0, None]
    assert [s.material for s in lens.surfaces] == ["N-BK7", 1.6201, None, None]
    assert [s.semi_diameter_mm for s in lens.surfaces][:3] == [None, 14.5, None]
    assert (lens.stop_index, lens.wavelengths_um, lens.object.field_diameter_mm) == (3, (0.58756,), 20.0)
    assert (lens.object.numerical_aperture, lens.object.working_distance_mm) == (0.05, 200.0)
    assert (lens.sensor.plane_distances_mm, result.dropped, result.pose) == ((190.0,), (), Pose())
    assert "do not block rays (AP without CHK) were ignored: surface 4 12.5 mm" in result.remarks[0]
    assert "surface 1: glass N-BK7 is that of Schott" in result.remarks[1]


def test_solves_and_pickups_are_evaluated(tmp_path: Path) -> None:
    """A beam of radius 15 mm that converges with slope 0.25 belongs to a focal length of 60 mm."""
    result = read(tmp_path, DOUBLET, far=True)
    first = first_order(result.lens)
    assert first.efl_mm == pytest.approx(15.0 / 0.25, rel=1e-9)
    assert result.lens.sensor.plane_distances_mm[0] == pytest.approx(first.bfl_mm, rel=1e-9)
    assert [s.material for s in result.lens.surfaces] == ["LASF35", None, "LASF35", None]
    assert [s.thickness_mm for s in result.lens.surfaces] == [5.0, 1.0, 5.0, None]
    assert result.lens.surfaces[0].stop
    words = " ".join(result.remarks)
    assert all(word in words for word in ("no aperture stop", "PU -0.25", "PY 0.0", "PK TH -2", "LASF35"))


@pytest.mark.parametrize(
    ("command", "thickness"), [("PK TH -1", 5.0), ("PK TH -1 0.5", 5.5), ("PK THM -1 7", 2.0)]
)
def test_pickups_of_a_thickness(tmp_path: Path, command: str, thickness: float) -> None:
    result = read(tmp_path, DOUBLET, "TH   1.0\n", f"{command}\n", far=True)
    assert result.lens.surfaces[1].thickness_mm == thickness


def test_a_height_solve_at_a_finite_object(tmp_path: Path) -> None:
    """The image of the object, where the marginal ray is on the axis, and 1 mm before that height."""
    result = read(tmp_path, SAVED, "TH   190.0", "PY 0.0")
    assert result.first_order is not None
    image_mm = result.first_order.image_distance_mm
    assert result.lens.sensor.plane_distances_mm[0] == pytest.approx(image_mm, rel=1e-9)
    defocused = read(tmp_path, SAVED, "TH   190.0", "PY 0.1").lens.sensor.plane_distances_mm[0]
    slope = math.tan(math.asin(0.05)) / abs(result.first_order.magnification)
    assert image_mm - defocused == pytest.approx(0.1 / slope, rel=1e-6)


def test_a_thick_lens_in_commands_on_one_line(tmp_path: Path) -> None:
    """The lensmaker's equation: 1 / f = (n - 1) (1 / r1 - 1 / r2 + (n - 1) d / (n r1 r2))."""
    text = (
        'len new "thick" 100 3; nao 0.01; obh 1; uni 1.0; wv 0.55; th 300; nxt; '
        "gla 1.5 1.5 1.5; rd 200; th 6; ast; nxt; cv -0.01; th 90; nxt; end 3"
    )
    result = read(tmp_path, text)
    power = 1.0 / 200.0 + 1.0 / 100.0 - 0.5 * 6.0 / (1.5 * 200.0 * 100.0)
    assert result.first_order is not None
    assert result.first_order.efl_mm == pytest.approx(1.0 / (0.5 * power), rel=1e-8)
    assert result.lens.surfaces[1].radius_mm == pytest.approx(-100.0, rel=1e-15)


def test_the_beam_radius_holds_at_surface_1(tmp_path: Path) -> None:
    lens = read(tmp_path, SAVED, "NAO  0.05", "EBR 10.0").lens
    assert lens.object.numerical_aperture == pytest.approx(math.sin(math.atan(10.0 / 200.0)), rel=1e-12)
    assert read(tmp_path, DOUBLET, "PU   -0.25", "RD 69.0", far=True).lens.object.numerical_aperture == (
        pytest.approx(math.sin(math.atan(15.0 / 500.0)), rel=1e-3)
    )


def test_aspheres(tmp_path: Path) -> None:
    terms = "RD -300.0\nCC -1.5\nAD 1e-7\nAE -2D-11\nAG 3e-19\nAH 0.0\nASP ADO"
    surface = read(tmp_path, SAVED, "RD   -300.0", terms).lens.surfaces[2]
    assert (surface.conic, surface.asphere) == (-1.5, (1e-7, -2e-11, 0.0, 3e-19))
    r = 7.0
    base = r * r / -300.0 / (1.0 + math.sqrt(1.0 + 0.5 * r * r / 300.0**2))
    sag = float(np.ravel(surface.shape.sag(np.array([0.0]), np.array([r])))[0])
    assert sag == pytest.approx(base + 1e-7 * r**4 - 2e-11 * r**6 + 3e-19 * r**10, rel=1e-12)


def test_model_glasses(tmp_path: Path) -> None:
    """The first wavelength counts; indices are those of the wavelengths in front of the glass."""
    colours = SAVED.replace("WV 0.58756\nWW 1.0", "WV 0.48613 0.65627\nWW 1.0 1.0")
    with pytest.raises(LossyImportError, match="surface 2: dispersion of the model glass MODEL1"):
        read(tmp_path, colours)
    lens = read(tmp_path, colours, lossy=True).lens
    assert (lens.surfaces[1].material, lens.wavelengths_um) == (1.6272360458395, (0.48613, 0.65627))
    between = read(tmp_path, SAVED.replace("WV 0.58756\nWW", "WV 0.55\nWW"))
    assert between.lens.surfaces[1].material == pytest.approx(1.6223, abs=5e-5)
    assert any("1.622" in remark and "interpolated" in remark for remark in between.remarks)
    with pytest.raises(LossyImportError, match=r"MODEL1 at 700 nm; that at 656\.27 nm"):
        read(tmp_path, SAVED.replace("WV 0.58756\nWW", "WV 0.7\nWW"))
    single = SAVED.replace("WV 0.58756 0.48613 0.65627", "WV 0.58756\nWV2 0.48613\nWV3 0.65627")
    assert read(tmp_path, single).lens == read(tmp_path, SAVED).lens


def test_values_that_oslo_supplies_are_remarked(tmp_path: Path) -> None:
    result = read(
        tmp_path, SAVED.replace("UNI  1.0\n", "").replace("GLA MOD MODEL1      1.6201 ", "GLA F2 //")
    )
    assert any("no units (UNI)" in remark for remark in result.remarks)
    plain = DOUBLET.replace("WV 0.6328\n", "").replace("PK  GLA  -2", "GLA LASF35")
    result = read(tmp_path, plain, far=True)
    assert result.lens.wavelengths_um == (0.58756, 0.48613, 0.65627)
    assert any("no wavelengths (WV)" in remark for remark in result.remarks)


@pytest.mark.parametrize(
    ("name", "index"),
    [("BAF4", 1.60562), ("F2", 1.62004), ("LF5", 1.58144), ("SK16", 1.62041), ("H-K9L", 1.5168)],
)
def test_old_names_are_those_of_schott(tmp_path: Path, name: str, index: float) -> None:
    """Indices at the d line by Schott's old catalogues; CDGM and LZOS use some of these names otherwise."""
    lens = read(tmp_path, SAVED, "N-BK7", name).lens
    assert lens.indices(0.5875618)[1] == pytest.approx(index, abs=2e-5)


@pytest.mark.parametrize("name", ["F7", "H_LAF2"])
def test_the_users_catalogue_supplies_unknown_names(tmp_path: Path, name: str) -> None:
    own = tmp_path / "own.agf"
    own.write_text(f"NM {name} 2 517642 1.5 64\nCD 1.04 0.006 0.23 0.02 1.01 103.5\nLD 0.4 0.7\n")
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(10, 10), glass_catalogs=(own,))
    result = read_len(saved(tmp_path, SAVED.replace("N-BK7", name)), supplement)
    assert 1.5 < result.lens.indices(0.5875618)[1] < 1.53


BLOCKS = """VAR NEW
V 1 4 0 CV 0 0
END
OPE NEW
O 1 "OCM1"
END
RST NEW
F 1 0.0 0.0 0.0 0.0 0.0 -1.0 1.0 -1.0 1.0 1.0
END
"""


def test_blocks_behind_the_lens_are_ignored(tmp_path: Path) -> None:
    assert read(tmp_path, SAVED + BLOCKS) == read(tmp_path, SAVED)


LOSSES = [
    ("GLA N-BK7", "RFL", "surface 1, line 13: mirror, read as a surface in air, 'RFL'"),
    ("GLA N-BK7", "RFH", "surface 1, line 13: mirror"),
    ("RD   110.0", "PFL 100.0", r"surface 1, line 14: perfect lens 'PFL 100\.0'"),
    ("RD   110.0", "GSP 0.001", "surface 1, line 14: grating"),
    ("RD   110.0", "RD 110\nCVX 0.01", "surface 1, line 15: toroid"),
    ("RD   110.0", "RD 110\nTLA 1.5", "surface 1, line 15: decenter or tilt 'TLA 1.5'"),
    ("RD   110.0", "RD 110; DCY 0.1", "surface 1, line 14: decenter or tilt"),
    ("RD   110.0", "RD 110; RCO", "surface 1, line 14: coordinates of another surface"),
    ("RD   110.0", "RD 110; AH 1e-20", "surface 1, line 14: asphere term"),
    ("RD   110.0", "RD 110; ASP ASR 2; AS2 1e-8", "surface 1, line 14: 'ASP ASR 2'.*\n.*'AS2 1e-8'"),
    ("RD   110.0", "RD 110; ASP SPL 3", "surface 1, line 14: 'ASP SPL 3'"),
    ("RD   110.0", "RD 110; APN 1; AY1 A -3", "surface 1, line 14: 'APN 1'.*\n.*'AY1 A -3'"),
    ("RD   110.0", "RD 110; GRD 2", "surface 1, line 14: 'GRD 2'"),
    ("RD   110.0", "RD 110; LMO NSS", "surface 1, line 14: group of surfaces"),
    ("UNI", "TELE ON\nUNI", "surface 0, line 6: telecentric"),
    ("UNI", "APCK OFF\nUNI", "surface 0, line 6: 'APCK OFF'"),
    ("END  5", "CALLBACK 1\nEND 5", "surface 5, line 37: commands that OSLO runs"),
    ("END  5", "PK TH -2\nEND 5", "surface 5: focus shift by 'PK TH -2'"),
    ("END  5", "RD 99\nEND 5", "surface 5: curved image surface"),
    ("AIR\nTH   200", "AIR\nRD -300\nTH 200", "surface 0: curved object surface"),
    ("AIR\nTH   200", "GLA N-BK7\nTH 200", "surface 0: object in N-BK7"),
    ("END  5", "END 5\nCFG NEW\nTH 1 2 3\nEND", r"line 38: configurations \(CFG\)"),
    ("END  5", "END 5\nRST NEW\nF 1 1 0 0 0 0 -0.8 1 -1 1 1\nEND", "vignetting factors"),
    ("END  5", "END 5\nWHAT 3", "line 38: 'WHAT 3'"),
]


@pytest.mark.parametrize(("old", "new", "message"), LOSSES)
def test_what_would_be_lost_is_listed(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(LossyImportError, match=message) as caught:
        read(tmp_path, SAVED, old, new)
    assert str(tmp_path / "lens.len") in str(caught.value)
    assert read(tmp_path, SAVED, old, new, lossy=True).dropped == caught.value.dropped


@pytest.mark.parametrize(
    "command", ["TELE OFF", "APCK ON", "CALLBACK 0", "DCX 0", "TLA 0.0", "LMO ELE", "AS3 0"]
)
def test_commands_that_state_nothing_are_ignored(tmp_path: Path, command: str) -> None:
    assert read(tmp_path, SAVED, "RD   110.0", f"RD 110.0; {command}") == read(tmp_path, SAVED)


@pytest.mark.parametrize("command", ["FNO 5.6", "NAP 0.1", "PUK -0.1"])
def test_apertures_at_the_image_are_a_loss(tmp_path: Path, command: str) -> None:
    with pytest.raises(
        LossyImportError, match=f"surface 0, line 3: system aperture at the image '{command}'"
    ):
        read(tmp_path, SAVED, "NAO  0.05", command)
    with pytest.raises(InputError, match="lacks numerical_aperture"):
        read(tmp_path, SAVED, "NAO  0.05", command, lossy=True)


FAULTS = [
    ("UNI  1.0", "UNI 10.0", r"line 6: UNI 10\.0: a unit of 10 mm; only lengths in mm"),
    ("UNI  1.0", "UNI 25.4", "a unit of 25.4 mm"),
    ("UNI  1.0", "UNI", "UNI has 0 values; it needs one"),
    ("NAO  0.05", "NAO 1.0", "NAO of 1 must be between 0 and 1"),
    ("NAO  0.05", "EBR -3", "EBR of -3 must be greater than 0"),
    ("NAO  0.05", "NAO 0.05\nEBR 3", "line 4: EBR is a second system aperture beside NAO"),
    ("TH   200.0", "TH 1e20", r"line 3: an object NA \(NAO\), but the object is at infinity"),
    ("RD   110.0", "RD 11o.0", "line 14: '11o.0' must be a finite number"),
    ("RD   110.0", "RD 1 2", "RD has 2 values"),
    ("RD   110.0", "RD nan", "'nan' must be a finite number"),
    ("RD   110.0", "RD 110\nRD 120", "line 15: RD gives the radius of surface 1, which RD gives already"),
    ("TH   8.0", "TH 8.0\nPY 0", "PY gives the thickness of surface 1, which TH gives already"),
    ("TH   8.0", "TH -8.0", "the next surface lies -8 mm behind surface 1"),
    ("TH   8.0", "EC 120", "line 15: the solve 'EC 120' of surface 1 .* does not reach that height"),
    ("TH   8.0", "EC -1", "line 15: EC of -1"),
    ("TH   8.0", "PYC 0", "the solve 'PYC 0' of surface 1 .* in front of the aperture stop"),
    ("RD   110.0", "PUC 0", "the solve 'PUC 0' of surface 1 .* in front of the aperture stop"),
    ("TH   8.0", "PK LN -1", "the pickup 'PK LN -1', which is not supported"),
    ("TH   8.0", "PK LN -1 -2", "picks up from '-2'"),
    ("TH   4.0", "PK LN -1 -1", "'PK LN -1 -1' of surface 2 ends in front of its first surface"),
    ("TH   8.0", "PK AAP -1", "the pickup 'PK AAP -1', which is not supported"),
    ("TH   8.0", "PK GLA -1 2", "the pickup 'PK GLA -1 2', which is not supported"),
    ("RD   -95.0", "PK CV -1; CC -1", "CC gives the conic constant of surface 2, which PK CV gives already"),
    ("TH   8.0", "PK TH 1", "picks up from '1'; only a preceding surface"),
    ("TH   8.0", "PK TH -3", "picks up from '-3'"),
    ("TH   8.0", "PK TH x", "'x' must be a whole number"),
    ("RD   -300.0", "RD -300; PFL 50\nPU 0.1", "PU gives the radius"),
    ("AIR\nTH   200.0", "AIR\nPY 0", "line 10: the solve 'PY 0' of surface 0"),
    ("AP CHK 14.5", "AP CHK -1", "AP of -1"),
    ("AP CHK 14.5", "AP WHAT 3", "AP has 2 values"),
    ("GLA N-BK7", "GLA", "line 13: GLA without a glass"),
    ("GLA N-BK7", "GLA MOD M1", "model glass 'MOD M1' without an index"),
    ("GLA N-BK7", "GLA MOD 1.6 50", "has an index of 50; allowed is 0.9992 to 10"),
    ("GLA N-BK7", "GLA 1.5 1.6", "has 2 indices, and there are 3 wavelengths"),
    ("GLA N-BK7", "GLA N-BK77", r"line 13 \(surface 1\): unknown material 'N-BK77'"),
    ("GLA N-BK7", "GLA H_LAF2", "the maker of the prefix H_ is not known"),
    ("GLA N-BK7", "GLA F7", r"line 13 \(surface 1\): glass 'F7' is known from CDGM alone"),
    ("WV 0.58756\n", "WV 0\n", "a wavelength of 0 um"),
    ("WV 0.58756\n", "WV\n", "WV without a wavelength"),
    ("WV 0.58756\n", "WV9 0.5\n", "WV9, but there are 3 wavelengths"),
    ("TH   8.0", "TH 8; AST", r"aperture stop \(AST\) at surface 1, surface 4"),
    ("END  5\n", "", "no END behind surface 5; is the file cut short"),
    ("END  5", "END 4", "the file states 4 surfaces behind the object, but has 5"),
    ("100 5", "100 6", "the file states 6 surfaces"),
    ("END  5", "END 5\nVAR NEW", "no END behind VAR"),
    ("END  5", "END 5\nLEN NEW", "line 38: a second LEN"),
    ("AIR\nTH   200.0", "GTO 3", "line 9: 'GTO 3'; only files in the order of NXT"),
    ("LEN NEW", "LEN UPD", "line 2: LEN"),
    ('first" 100 5', "first 100 5", "line 2: a quotation mark is not closed"),
    ("// OSLO 6.6", "OSLO 6.6", "line 1: 'OSLO' before LEN NEW"),
]


@pytest.mark.parametrize(("old", "new", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    for lossy in (False, True):
        with pytest.raises((InputError, MaterialError), match=message) as caught:
            read(tmp_path, SAVED, old, new, lossy)
        assert str(caught.value).startswith(str(tmp_path / "lens.len"))


def test_solves_that_cannot_be_evaluated_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"line 22: the solve 'PU -0\.25' of surface 4 .* lacks EBR and NAO"):
        read(tmp_path, DOUBLET, "EBR  15.0\n", "", far=True)
    with pytest.raises(InputError, match="cannot represent"):
        read(tmp_path, DOUBLET, "TH   1.0\n", "TH 1.0; PFL 100\n", lossy=True, far=True)
    with pytest.raises(InputError, match="the marginal ray runs along the axis or parallel to it"):
        read(tmp_path, DOUBLET, "PU   -0.25", "PU 0", far=True)
    text = DOUBLET.replace("EBR  15.0\n", "").replace("PU   -0.25", "RD 69")
    supplement = Supplement(
        working_distance_mm=500.0,
        field_diameter_mm=1.0,
        numerical_aperture=0.03,
        pixel_pitch_um=3.2,
        pixels=(10, 10),
    )
    lens = read_len(saved(tmp_path, text), supplement).lens
    assert lens.sensor.plane_distances_mm[0] == pytest.approx(first_order(lens).bfl_mm, rel=1e-9)


def test_an_object_at_infinity_needs_values(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lacks working_distance_mm, field_diameter_mm"):
        read(tmp_path, DOUBLET.replace("ANG", "OBH"))


def test_without_a_stop_it_is_the_first_plane(tmp_path: Path) -> None:
    """A plane in air in front of the lens stays a surface if it is the stop."""
    text = SAVED.replace("AST\n", "").replace("NXT  // SRF 1\n", "NXT\nAIR; TH 3\nNXT\n")
    lens = read(tmp_path, text.replace("100 5", "100 6").replace("END  5", "END 6")).lens
    assert (lens.stop_index, lens.surfaces[0].thickness_mm, lens.surfaces[0].radius_mm) == (0, 3.0, None)


@pytest.mark.parametrize("text", [SAVED + BLOCKS, DOUBLET])
def test_a_cut_file_is_refused(tmp_path: Path, text: str) -> None:
    """A cut at the end of a line, except behind a complete lens."""
    lines = text.splitlines(keepends=True)
    end = next(i for i, line in enumerate(lines) if line.startswith("END")) + 1
    for count in range(end):
        with pytest.raises(InputError):
            read_len(saved(tmp_path, "".join(lines[:count])), FAR)


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    where=st.integers(0, len(SAVED) - 1),
    replacement=st.text(st.characters(codec="latin-1"), max_size=4)
    | st.sampled_from(["1e999", "PK", "-", "//"]),
    lossy=st.booleans(),
)
def test_damaged_files_give_a_lens_or_a_message(
    tmp_path: Path, where: int, replacement: str, lossy: bool
) -> None:
    path = tmp_path / "lens.len"
    path.write_bytes((SAVED[:where] + replacement + SAVED[where + 1 :]).encode("latin-1"))
    with contextlib.suppress(InputError, MaterialError):
        lens = read_len(path, SENSOR, lossy).lens
        assert np.isfinite(lens.indices(lens.wavelengths_um[0])).all()


def oslo_text(lens: Lens) -> str:
    """Return a lens as OSLO would save it."""
    media = [f"GLA {s.material}" if s.material is not None else "AIR" for s in lens.surfaces]
    thicknesses = [*(s.thickness_mm for s in lens.surfaces[:-1]), lens.sensor.plane_distances_mm[0]]
    lines = [
        f'LEN NEW "random" 100 {len(lens.surfaces) + 1}',
        f"NAO {lens.object.numerical_aperture!r}",
        f"OBH {0.5 * lens.object.field_diameter_mm!r}",
        "UNI 1.0",
        f"TH {lens.object.working_distance_mm!r}",
        "NXT",
    ]
    for surface, medium, thickness in zip(lens.surfaces, media, thicknesses, strict=True):
        lines += [medium, f"TH {thickness!r}"]
        lines += [f"RD {surface.radius_mm!r}"] if surface.radius_mm is not None else []
        lines += [f"CC {surface.conic!r}"] if surface.conic else []
        lines += [f"{word} {a!r}" for word, a in zip(("AD", "AE", "AF", "AG"), surface.asphere, strict=False)]
        lines += [f"AP CHK {surface.semi_diameter_mm!r}"] if surface.semi_diameter_mm is not None else []
        lines += ["AST"] if surface.stop else []
        lines += ["NXT"]
    lines += ["WV " + " ".join(map(repr, lens.wavelengths_um)), f"END {len(lens.surfaces) + 1}"]
    return "\n".join(lines)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(lens=lenses())
def test_random_lenses_have_the_same_surfaces_and_rays(tmp_path: Path, lens: Lens) -> None:
    rows = [
        SurfaceRow("", "", s.radius_mm, s.conic, {"asphere": s.asphere}, s.thickness_mm or 1.0, s.material)
        if not s.stop
        else SurfaceRow("", "", stop=True, semi_diameter_mm=1.0)
        for s in lens.surfaces
    ]
    assume(len(fold_dummy_planes([SurfaceRow("", ""), *rows, SurfaceRow("", "")])) == len(rows) + 2)
    supplement = Supplement(
        numerical_aperture=lens.object.numerical_aperture,
        pixel_pitch_um=lens.sensor.pixel_pitch_um,
        pixels=lens.sensor.pixels,
        plane_distances_mm=lens.sensor.plane_distances_mm,
    )
    found = read_len(saved(tmp_path, oslo_text(lens)), supplement).lens
    expected = tuple(s.replaced(asphere=without_zeros(s.asphere)) for s in lens.surfaces)
    assert found.surfaces == expected
    assert (found.object, found.sensor) == (lens.object, lens.sensor)
    assert found.wavelengths_um == lens.wavelengths_um
    for hits, other in zip(hits_of(found), hits_of(lens), strict=True):
        np.testing.assert_allclose(hits, other, rtol=0.0, atol=1e-11)


def hits_of(lens: Lens) -> tuple[np.ndarray, np.ndarray]:
    """Return points and directions of rays from the axis and the edge of the field behind the lens."""
    field = [[0.0, 0.0], [0.0, 0.5 * lens.object.field_diameter_mm]]
    wavelength_um = lens.wavelengths_um[0]
    rays = trace(lens, *launch(lens, field, pupil_hexapolar(2).points, wavelength_um), wavelength_um)
    return rays.position, rays.direction


def test_air_is_air_in_small_letters(tmp_path: Path) -> None:
    assert read(tmp_path, SAVED, "AIR\nTH   190.0", "GLA air\nTH   190.0").lens == read(tmp_path, SAVED).lens


def test_a_binary_file_of_codev_is_refused_with_advice(tmp_path: Path) -> None:
    path = tmp_path / "lens.len"
    path.write_bytes(b"]\0\0\0X\0\0\0\xb0P\xd0 \xf0d;<New lens from CVMACRO:cvnewlens.seq" + b"\0\xd8" * 99)
    with pytest.raises(InputError, match=r"not a text file; CODE V's own lens files end in \.len, too"):
        read_len(path)


def test_conditions_of_drawings_do_not_describe_the_lens(tmp_path: Path) -> None:
    path = tmp_path / "lens.len"
    text = (
        'LEN NEW "Singlet" 100 3; NAO 0.1; OBH 4; UNI 1; WV 0.5876; TH 60; NXT; '
        "GLA N-BK7; RD 50; TH 5; NXT; RD -50; PY 0; NXT; DLNF 3; END 3\nDLRS 3\n"
    )
    path.write_text(text)
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(1000, 800))
    assert read_len(path, supplement).dropped == ()
    path.write_text(text + "DLR 3\n")
    with pytest.raises(LossyImportError, match="line 3: 'DLR 3'"):
        read_len(path, supplement)


def test_a_picked_up_aperture_changes_no_ray(tmp_path: Path) -> None:
    path = GOLDEN / "imports" / "pk_ap.len"
    result = read_len(path, SENSOR)
    assert result.dropped == ()
    assert "surface 2: PK AP -1 replaced by its value, none" in result.remarks
    plain = read_len(saved(tmp_path, path.read_text().replace("PK AP -1\n", "")), SENSOR)
    assert result.lens == plain.lens
    given = read(tmp_path, SAVED, "RD   -300.0", "RD -300\nPK AP -1")
    assert "surface 3: PK AP -1 replaced by its value, an aperture of 14.5 mm" in given.remarks
    assert given.lens == read(tmp_path, SAVED).lens


@pytest.mark.parametrize(
    ("command", "radius", "sign"),
    [
        ("PK CV -1", -95.0, 1),
        ("PK CV 2", -95.0, 1),
        ("PK CVM -1", 95.0, -1),
        ("PK CV -1 0.001", 1.0 / (-1.0 / 95.0 + 0.001), 1),
    ],
)
def test_a_picked_up_profile(tmp_path: Path, command: str, radius: float, sign: int) -> None:
    """Curvature with conic constant and asphere terms; PK CVM is the mirror image."""
    text = SAVED.replace("RD   -95.0", "RD -95\nCC -0.5\nAD 1e-7")
    lens = read(tmp_path, text, "RD   -300.0", command).lens
    assert lens.surfaces[2].radius_mm == pytest.approx(radius, rel=1e-12)
    assert (lens.surfaces[2].conic, lens.surfaces[2].asphere) == (-0.5, (sign * 1e-7,))


@pytest.mark.parametrize(
    ("command", "thickness"),
    [("PK LN -2 -1", 8.0), ("PK LN -2 0", 12.0), ("PK LNM -2 0 22", 10.0), ("PK LN 1 2 1.5", 9.5)],
)
def test_a_picked_up_length(tmp_path: Path, command: str, thickness: float) -> None:
    lens = read(tmp_path, SAVED, "TH   10.0", command).lens
    assert lens.surfaces[2].thickness_mm == pytest.approx(thickness, rel=1e-12)


def test_decenters_are_picked_up_only_where_there_are_some(tmp_path: Path) -> None:
    assert read(tmp_path, SAVED, "RD   -300.0", "RD -300\nPK TD -1").lens == read(tmp_path, SAVED).lens
    with pytest.raises(LossyImportError, match="surface 3, line 27: decenter or tilt 'PK TD -1'"):
        read(tmp_path, SAVED.replace("RD   -95.0", "RD -95; TLA 1"), "RD   -300.0", "RD -300\nPK TD -1")


def test_edges_touch_at_the_height_of_the_solve(tmp_path: Path) -> None:
    """sag = R - sqrt(R^2 - h^2): the lens is as thick as both of its sags at the edge."""
    lens = read(tmp_path, SAVED, "TH   8.0", "EC 20").lens
    expected = (110.0 - math.sqrt(110.0**2 - 400.0)) + (95.0 - math.sqrt(95.0**2 - 400.0))
    assert lens.surfaces[0].thickness_mm == pytest.approx(expected, rel=1e-12)
    picked = SAVED.replace("RD   -95.0", "PK CVM -1")
    lens = read(tmp_path, picked, "TH   8.0", "EC 20").lens
    assert lens.surfaces[0].thickness_mm == pytest.approx(2.0 * (110.0 - math.sqrt(110.0**2 - 400.0)))


STOP_FIRST = """LEN NEW "chief" 100 4
NAO 0.05
OBH -10.0
UNI 1.0
TH 200.0
NXT
AST
TH 12.0
NXT
GLA 1.5
RD 60.0
TH 6.0
NXT
AIR
RD -80.0
TH 90.0
NXT
WV 0.58756
END 4
"""


def chief_ray(lens: Lens, height_mm: float) -> tuple[list[float], list[float], list[float]]:
    """Return heights, slopes behind, and angles of incidence of the paraxial ray through the stop."""
    y, u, index = 0.0, -height_mm / lens.object.working_distance_mm, 1.0
    heights, slopes, angles = [], [], []
    for surface, behind in zip(lens.surfaces, lens.indices(0.58756)[1:], strict=True):
        curvature = 0.0 if surface.radius_mm is None else 1.0 / surface.radius_mm
        heights.append(y)
        angles.append(u + y * curvature)
        u = (index * u - (behind - index) * curvature * y) / behind
        slopes.append(u)
        y, index = y + (surface.thickness_mm or lens.sensor.plane_distances_mm[0]) * u, float(behind)
    return [*heights, y], slopes, angles


@pytest.mark.parametrize(
    ("old", "command", "which", "place", "target"),
    [
        ("TH 90.0", "PYC 3.5", 0, 3, 3.5),
        ("TH 12.0", "PYC 0.5", 0, 1, 0.5),
        ("RD -80.0", "PUC 0.02", 1, 2, 0.02),
        ("RD 60.0", "PUC 0.01", 1, 1, 0.01),
        ("RD -80.0", "PIC 0.01", 2, 2, 0.01),
    ],
)
def test_solves_of_the_chief_ray(
    tmp_path: Path, old: str, command: str, which: int, place: int, target: float
) -> None:
    lens = read(tmp_path, STOP_FIRST, old, command).lens
    assert chief_ray(lens, -10.0)[which][place] == pytest.approx(target, rel=1e-10)


def test_the_chief_ray_meets_the_center_of_a_stop_behind_lenses(tmp_path: Path) -> None:
    """The exact ray near the axis that crosses the stop's center has the height of the solve at the image."""
    text = SAVED.replace("OBH  -10.0", "OBH -0.001")
    lens = read(tmp_path, text, "TH   190.0", "PYC 0.0008").lens
    slopes = np.array([0.0, 1e-6])
    origins = np.array([[0.0, -0.001, lens.object_z_mm]] * 2)
    directions = np.column_stack([np.zeros(2), slopes, np.ones(2)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    at_stop = trace(lens, origins, directions, 0.58756, Pose(), lens.vertex_z_mm[3], clip=False).position
    at_image = trace(lens, origins, directions, 0.58756, Pose(), lens.sensor_z_mm[0], clip=False).position
    fraction = -at_stop[0, 1] / (at_stop[1, 1] - at_stop[0, 1])
    height = at_image[0, 1] + fraction * (at_image[1, 1] - at_image[0, 1])
    assert height == pytest.approx(0.0008, rel=1e-6)


def test_an_angle_of_incidence_of_the_marginal_ray(tmp_path: Path) -> None:
    """At surface 1 the ray has the slope tan u of NA 0.05; its angle of incidence is u + y / R."""
    lens = read(tmp_path, SAVED, "RD   110.0", "PI 0.15").lens
    tangent = math.tan(math.asin(0.05))
    assert lens.surfaces[0].radius_mm == pytest.approx(200.0 * tangent / (0.15 - tangent), rel=1e-12)


def test_the_chief_ray_of_an_object_at_infinity(tmp_path: Path) -> None:
    """Behind a stop in front of a thin lens in its front focus, the chief ray runs parallel to the axis."""
    far = STOP_FIRST.replace("TH 200.0", "TH 1e20").replace("NAO 0.05", "EBR 1").replace("OBH -10.0", "ANG 5")
    lens = read(tmp_path, far, "RD -80.0", "PUC 0.0", far=True).lens
    front_focus_mm = first_order(lens).efl_mm
    assert front_focus_mm > 0.0
    heights, slopes, _ = chief_ray(lens, -math.tan(math.radians(5.0)) * lens.object.working_distance_mm)
    assert slopes[2] == pytest.approx(0.0, abs=1e-12)
    assert heights[3] == pytest.approx(heights[2], rel=1e-12)


def test_the_thickness_of_the_image_surface_moves_the_sensor(tmp_path: Path) -> None:
    result = read(tmp_path, SAVED, "AIR\nWV 0.58756\nWW", "AIR\nTH 0.25\nWV 0.58756\nWW")
    assert (result.lens.sensor.plane_distances_mm, result.dropped) == ((190.25,), ())
    solved = read(tmp_path, SAVED.replace("TH   190.0", "PY 0.0"), "END  5", "TH -0.5\nEND 5")
    assert solved.first_order is not None
    planes = solved.lens.sensor.plane_distances_mm
    assert planes[0] == pytest.approx(solved.first_order.image_distance_mm - 0.5, rel=1e-9)
