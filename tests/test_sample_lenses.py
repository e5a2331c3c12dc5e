"""Lens files as makers publish them: focal lengths, glasses and stops as they are known to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from sample_lenses import SAMPLES, Sample
from supplements import SUPPLEMENT

from lensdesign import Lens, Pose
from lensdesign.analysis.paraxial import first_order
from lensdesign.files.codev import read_seq, write_seq
from lensdesign.files.draft import Imported, LossyImportError
from lensdesign.files.zemax import read_zmx, write_zmx

FAR = replace(SUPPLEMENT, working_distance_mm=500.0, numerical_aperture=0.005)
READERS = {".zmx": read_zmx, ".seq": read_seq}
CASES = [(name, encoding) for name, sample in SAMPLES.items() for encoding in sample.encodings]


def imported(folder: Path, sample: Sample, encoding: str, lossy: bool = False) -> Imported:
    path = folder / f"lens{sample.suffix}"
    path.write_bytes(sample.text.replace("\n", "\r\n").encode(encoding))
    return READERS[sample.suffix](path, FAR, lossy)


@pytest.mark.parametrize(("name", "encoding"), CASES)
def test_samples_are_what_they_are_known_to_be(tmp_path: Path, name: str, encoding: str) -> None:
    sample = SAMPLES[name]
    if sample.dropped:
        with pytest.raises(LossyImportError) as caught:
            imported(tmp_path, sample, encoding)
        assert caught.value.dropped == sample.dropped
    found = imported(tmp_path, sample, encoding, lossy=bool(sample.dropped))
    lens = found.lens
    assert (found.dropped, found.pose) == (sample.dropped, Pose())
    assert tuple(s.material for s in lens.surfaces) == sample.glasses
    assert (lens.stop_index, lens.surfaces[sample.stop].stop) == (sample.stop, True)
    if sample.radii_mm:
        assert tuple(s.radius_mm for s in lens.surfaces) == sample.radii_mm
    first = first_order(lens)
    assert first.efl_mm == pytest.approx(sample.efl_mm[0], abs=sample.efl_mm[1])
    assert first.bfl_mm == pytest.approx(sample.bfl_mm[0], abs=sample.bfl_mm[1])


@pytest.mark.parametrize("name", SAMPLES)
def test_samples_go_through_both_formats(tmp_path: Path, name: str) -> None:
    lens = imported(tmp_path, SAMPLES[name], "utf-8", lossy=True).lens
    write_zmx(lens, tmp_path / "a.zmx")
    write_seq(lens, tmp_path / "a.seq")
    assert read_zmx(tmp_path / "a.zmx").lens == lens
    assert read_seq(tmp_path / "a.seq").lens == lens


def test_the_lens_of_the_paper(tmp_path: Path, paper_lens: Lens) -> None:
    """Table 1: R1 = 42.3 mm, R2 = -12 mm, conic -0.89862, 9.7 mm of N-BK7."""
    for write, read, path in ((write_zmx, read_zmx, "a.zmx"), (write_seq, read_seq, "a.seq")):
        write(paper_lens, tmp_path / path)
        lens = read(tmp_path / path).lens
        assert [s.radius_mm for s in lens.surfaces] == [42.3, -12.0]
        assert (lens.surfaces[1].conic, lens.surfaces[0].thickness_mm) == (-0.89862, 9.7)
        assert (lens.surfaces[0].material, lens.stop_index) == ("N-BK7", 0)
        n = 1.5194726
        power = (n - 1) * (1 / 42.3 + 1 / 12 - (n - 1) * 9.7 / (n * 42.3 * 12))
        assert first_order(lens).efl_mm == pytest.approx(1.0 / power, rel=1e-6)
