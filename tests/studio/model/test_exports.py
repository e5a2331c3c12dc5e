"""Files of the lens: each kind is written, and nothing that stands there is lost."""

from __future__ import annotations

from pathlib import Path

import pytest

from lensdesign import InputError, Lens, read_zmx
from studio.model.exports import KINDS, write_export


@pytest.mark.parametrize("suffix", sorted({s for s in KINDS.values() if s} - {".step", ".stl"}))
def test_kinds_are_written(paper_lens: Lens, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"lens{suffix}"
    assert write_export(paper_lens, file, None, False, lambda _: None).startswith(f"wrote {file}")
    assert file.stat().st_size > 200


def test_what_stands_there_stays_unless_it_may_be_replaced(paper_lens: Lens, tmp_path: Path) -> None:
    file = tmp_path / "lens.zmx"
    file.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_export(paper_lens, file, None, False, lambda _: None)
    assert file.read_text() == "mine"
    write_export(paper_lens, file, None, True, lambda _: None)
    assert read_zmx(file).lens.surfaces[0].radius_mm == pytest.approx(42.3)


def test_unknown_kinds_are_refused(paper_lens: Lens, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown suffix"):
        write_export(paper_lens, tmp_path / "lens.xyz", None, False, lambda _: None)
    with pytest.raises(InputError, match="needs tolerances"):
        write_export(paper_lens, tmp_path / "report", None, False, lambda _: None)
