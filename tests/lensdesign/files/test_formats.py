"""What every format of other programs must do: a design comes back, and what it cannot hold is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import GOLDEN
from random_lenses import lenses, poses
from supplements import SUPPLEMENT

from lensdesign import InputError, Lens, MaterialError, Pose, files
from lensdesign.files.draft import LossyImportError, Supplement
from lensdesign.files.formats import LENS_FORMATS, WRITTEN_LENS_FORMATS, read_lens_file, write_lens_file
from lensdesign.lens.shapes.even_asphere import without_zeros
from lensdesign.lens.surface_figure_source import SurfaceFigureSource

POSE = Pose(0.1, -0.2, 0.0, 1.5, -0.7, 4.4)

# How our remarks begin, and the encoding.
OTHERS = {".zmx": ("NOTE", "utf-16"), ".seq": ("!", "utf-8")}

OSLO = """LEN NEW "singlet" 50 3
NAO 0.02
OBH 1.0
UNI 1.0
TH 100.0
NXT
AST
RD 50.0
TH 3.0
AP CHK 4.0
GLA N-BK7
NXT
RD -50.0
TH 60.0
AIR
NXT
END
"""


def bare(lens: Lens) -> Lens:
    """A lens whose aspheres have no zeros at their end."""
    return lens.replaced(surfaces=tuple(s.replaced(asphere=without_zeros(s.asphere)) for s in lens.surfaces))


def write(lens: Lens, path: Path, pose: Pose) -> None:
    getattr(files, str(LENS_FORMATS[path.suffix].writer))(lens, path, pose)


@pytest.fixture(params=WRITTEN_LENS_FORMATS)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A name for a file of each format, in a folder that is made with it."""
    return tmp_path / "folder" / f"lens{request.param}"


def test_every_format_is_tested() -> None:
    assert OTHERS.keys() == WRITTEN_LENS_FORMATS.keys()
    assert WRITTEN_LENS_FORMATS.items() <= LENS_FORMATS.items()


def test_a_format_that_is_only_read_is_not_written(tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / "lens.len"
    with pytest.raises(InputError, match=r"cannot write .*\.zmx or \.seq"):
        write_lens_file(paper_lens, path)
    assert not path.exists()


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lens=lenses(), pose=st.just(Pose()) | poses(None))
def test_a_design_comes_back(path: Path, lens: Lens, pose: Pose) -> None:
    write(lens, path, pose)
    result = read_lens_file(path)
    assert result.lens == bare(lens)
    assert result.pose == pose
    assert (result.dropped, result.remarks) == ((), ())


def test_a_design_of_other_makers_comes_back(path: Path, tmp_path: Path, paper_lens: Lens) -> None:
    own = tmp_path / "own.agf"
    own.write_text("NM MY-GLASS 2 517642 1.5 64\nCD 1.04 0.006 0.23 0.02 1.01 103.5\nLD 0.4 0.7\n")
    names = ["OHARA:S-BSL7", "SCHOTT:F2", "hikari:f2", "FUSED SILICA", "PMMA"]
    for name in names + ["own.agf:MY-GLASS", "my-glass"] * (path.suffix == ".zmx"):
        lens = paper_lens.replaced(glass_catalogs=(own,)) if "my" in name.lower() else paper_lens
        changed = lens.with_surface(0, material=name)
        write_lens_file(changed, path)
        assert read_lens_file(path, Supplement(glass_catalogs=changed.glass_catalogs)).lens == changed


def test_without_our_remarks_glasses_and_pose_are_the_same(path: Path, paper_lens: Lens) -> None:
    write(paper_lens, path, POSE)
    remark, encoding = OTHERS[path.suffix]
    lines = [x for x in path.read_text(encoding=encoding).splitlines() if not x.startswith(remark)]
    path.write_text("\n".join(lines), encoding=encoding)
    result = read_lens_file(path, Supplement(pixel_pitch_um=3.2, pixels=(9344, 7000)))
    for name, value in vars(POSE).items():
        assert getattr(result.pose, name) == pytest.approx(value, abs=1e-12)
    assert result.lens.surfaces == paper_lens.surfaces
    assert result.lens.object.working_distance_mm == pytest.approx(13.5, abs=1e-12)
    assert result.lens.sensor.plane_distances_mm == pytest.approx((2.0,), abs=1e-12)


def test_what_no_file_of_the_format_can_hold_is_not_written(path: Path, paper_lens: Lens) -> None:
    figure = SurfaceFigureSource(zernike_um=((4, 0.1),), semi_diameter_mm=20.0)
    with pytest.raises(InputError, match=rf"surface 1.*\{path.suffix}.*figure"):
        write_lens_file(paper_lens.with_surface(0, figure=figure), path)
    with pytest.raises(InputError, match="pose"):
        write(paper_lens, path, Pose(np.zeros(3)))
    with pytest.raises(MaterialError, match="unknown material"):
        write_lens_file(paper_lens.with_surface(0, material="N-BK77"), path)
    assert not path.exists()


@pytest.mark.parametrize("suffix", [".zar", ".ZOS", ".zmf"])
def test_files_that_are_not_text_are_refused_with_advice(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(InputError, match=r"Zemax OpticStudio; .*\.zmx"):
        read_lens_file(tmp_path / f"lens{suffix}")


def test_names_of_archives_are_refused_for_writing_with_the_allowed_ones(
    tmp_path: Path, paper_lens: Lens
) -> None:
    with pytest.raises(InputError, match=r"cannot write .*lens\.zar: the name must end in \.zmx or \.seq"):
        write_lens_file(paper_lens, tmp_path / "lens.zar")


@pytest.mark.parametrize("suffix", LENS_FORMATS)
def test_stated_wavelengths_replace_those_of_the_file(suffix: str, tmp_path: Path, paper_lens: Lens) -> None:
    path = tmp_path / f"lens{suffix}"
    if suffix == ".len":
        path.write_text(OSLO)
    else:
        write_lens_file(paper_lens, path)
    supplement = Supplement(pixel_pitch_um=3.2, pixels=(100, 100), wavelengths_um=(0.633, 0.45))
    found = read_lens_file(path, supplement, lossy=True)
    assert found.lens.wavelengths_um == (0.633, 0.45)
    assert found.first_order is not None
    with pytest.raises(InputError, match="wavelengths_um"):
        read_lens_file(path, Supplement(wavelengths_um=(0.0,)))


IMPORTS = GOLDEN / "imports"
LONG = {
    ".len": ("pk_ap.len", "GLA N-BK7\n", "N-BK7"),
    ".seq": ("unused_private_glass.seq", " STO\n", "NBK7"),
    ".zmx": ("unindented_record.zmx", "  TYPE STANDARD\n", "N-BK7"),
}
"""For each format a file, a line behind which a piece is inserted, and the name of a glass."""


def with_piece(tmp_path: Path, suffix: str, piece: str) -> Path:
    name, line, _ = LONG[suffix]
    text = (IMPORTS / name).read_text(encoding="utf-8")
    assert line in text
    path = tmp_path / f"long{suffix}"
    path.write_text(text.replace(line, f"{line}{piece}\n", 1))
    return path


@pytest.mark.parametrize("suffix", LONG)
def test_many_lost_records_are_listed(tmp_path: Path, suffix: str) -> None:
    """The time grows with the number of records; with its square, this would take many minutes."""
    count = 100_000
    path = with_piece(tmp_path, suffix, "\n".join(f"QQ{i:x} {i}" for i in range(count)))
    with pytest.raises(LossyImportError) as caught:
        read_lens_file(path, SUPPLEMENT)
    assert len(caught.value.dropped) >= count
    assert len(str(caught.value)) < 10_000


@pytest.mark.parametrize("suffix", LONG)
@pytest.mark.parametrize("piece", ['"\\', "'\"", "& ", "/ ", '"a" ', "; ", "(", "\\"])
def test_a_long_line_gets_a_result_or_a_short_message(tmp_path: Path, suffix: str, piece: str) -> None:
    """The time grows with the length of the line; with its square, this would take an hour."""
    path = with_piece(tmp_path, suffix, "COM " + piece * 300_000)
    message = ""
    try:
        read_lens_file(path, SUPPLEMENT, lossy=True)
    except InputError as error:
        message = str(error)
    assert len(message) < 2_000


@pytest.mark.parametrize("suffix", LONG)
def test_a_long_name_of_a_glass_is_refused_in_a_short_message(tmp_path: Path, suffix: str) -> None:
    name, _, glass = LONG[suffix]
    path = tmp_path / f"long{suffix}"
    text = (IMPORTS / name).read_text(encoding="utf-8")
    assert glass in text
    path.write_text(text.replace(glass, "Q" * 300_000))
    with pytest.raises(InputError) as caught:
        read_lens_file(path, SUPPLEMENT, lossy=True)
    assert len(str(caught.value)) < 1_000


@pytest.mark.parametrize("suffix", sorted(OTHERS))
@pytest.mark.parametrize("number", ["0", "-0.532", "1e-200", "1e200"])
def test_a_wavelength_that_is_no_length_is_refused_before_an_index_is_computed(
    paper_lens: Lens, tmp_path: Path, suffix: str, number: str
) -> None:
    path = tmp_path / f"lens{suffix}"
    write_lens_file(paper_lens, path)
    encoding = OTHERS[suffix][1]
    text = path.read_text(encoding=encoding)
    stated = {".zmx": "WAVM 1 0.532 1", ".seq": "WL 532.000"}[suffix]
    assert text.count(stated) == 1
    changed = {".zmx": f"WAVM 1 {number} 1", ".seq": f"WL {number}"}[suffix]
    path.write_text(text.replace(stated, changed), encoding=encoding)
    with pytest.raises(InputError, match="must be greater than 0 and finite"):
        read_lens_file(path)
    given = Supplement(wavelengths_um=(0.532,))
    assert read_lens_file(path, given).lens.wavelengths_um == (0.532,)
