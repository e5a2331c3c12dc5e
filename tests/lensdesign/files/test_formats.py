"""What every format of other programs must do: a design comes back, and a damaged file is refused by name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lens_files import bare, mutilated
from places import GOLDEN
from random_lenses import lenses, poses

from lensdesign import InputError, Lens, MaterialError, Pose, files
from lensdesign.files.draft import Supplement
from lensdesign.files.formats import LENS_FORMATS, read_lens_file, write_lens_file
from lensdesign.lens.figure_source import FigureSource

POSE = Pose(0.1, -0.2, 0.0, 1.5, -0.7, 4.4)

# Words that upset the reader, how our remarks begin, encoding.
OTHERS = {
    ".zmx": ([b"INFINITY", b"()"], "NOTE", "utf-16"),
    ".seq": ([b"S99", b"&", b"'", b";"], "!", "utf-8"),
}


def write(lens: Lens, path: Path, pose: Pose) -> None:
    getattr(files, LENS_FORMATS[path.suffix].writer)(lens, path, pose)


@pytest.fixture(params=LENS_FORMATS)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A name for a file of each format, in a folder that is made with it."""
    return tmp_path / "folder" / f"lens{request.param}"


def test_every_format_is_tested() -> None:
    assert OTHERS.keys() == LENS_FORMATS.keys()


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
    _, remark, encoding = OTHERS[path.suffix]
    lines = [x for x in path.read_text(encoding=encoding).splitlines() if not x.startswith(remark)]
    path.write_text("\n".join(lines), encoding=encoding)
    result = read_lens_file(path, Supplement(pixel_pitch_um=3.2, pixels=(9344, 7000)))
    for name, value in vars(POSE).items():
        assert getattr(result.pose, name) == pytest.approx(value, abs=1e-12)
    assert result.lens.surfaces == paper_lens.surfaces
    assert result.lens.object.working_distance_mm == pytest.approx(13.5, abs=1e-12)
    assert result.lens.sensor.plane_distances_mm == pytest.approx((2.0,), abs=1e-12)


def test_what_no_file_of_the_format_can_hold_is_not_written(path: Path, paper_lens: Lens) -> None:
    figure = FigureSource(zernike_um=((4, 0.1),), semi_diameter_mm=20.0)
    with pytest.raises(InputError, match=rf"surface 1.*\{path.suffix}.*figure"):
        write_lens_file(paper_lens.with_surface(0, figure=figure), path)
    with pytest.raises(InputError, match="pose"):
        write(paper_lens, path, Pose(np.zeros(3)))
    with pytest.raises(MaterialError, match="unknown material"):
        write_lens_file(paper_lens.with_surface(0, material="N-BK77"), path)
    assert not path.exists()


def test_mutilated_files_give_a_lens_or_a_fault(path: Path, paper_lens: Lens) -> None:
    write(paper_lens, path, Pose(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))
    others = sorted((GOLDEN / "imports").glob(f"*{path.suffix}"))
    seeds, rng = [one.read_bytes() for one in (path, *others)], np.random.default_rng(11)
    supplement = Supplement(100.0, 1.0, 0.02, 3.2, (1000, 800))
    read, messages = 0, []
    for trial in range(500):
        path.write_bytes(mutilated(bytearray(seeds[trial % len(seeds)]), rng, OTHERS[path.suffix][0]))
        try:
            read_lens_file(path, supplement, lossy=bool(trial % 2))
            read += 1
        except InputError as error:
            messages.append(str(error))
    assert 20 < read < 480
    assert all(str(path) in message for message in messages)
