"""The cover glass of a sensor in a design: validation, scaling, and files."""

from __future__ import annotations

from pathlib import Path

import pytest

from lensdesign import CoverGlass, DesignError, Lens, MaterialError, load_design, save_design, scaled

GLASS = CoverGlass(thickness_mm=0.7, material="N-BK7", distance_mm=0.5)


@pytest.fixture
def covered(paper_lens: Lens) -> Lens:
    return paper_lens.replaced(sensor=paper_lens.sensor.replaced(cover_glass=GLASS))


def test_a_design_file_keeps_the_cover_glass(covered: Lens, tmp_path: Path) -> None:
    save_design(covered, tmp_path / "lens.toml")
    assert load_design(tmp_path / "lens.toml") == covered


def test_a_scaled_lens_has_a_scaled_cover_glass(covered: Lens) -> None:
    glass = scaled(covered, 0.25).sensor.cover_glass
    assert glass == CoverGlass(thickness_mm=0.175, material="N-BK7", distance_mm=0.125)


def test_the_plate_must_fit_in_front_of_the_nearest_plane(covered: Lens) -> None:
    sensor = covered.sensor
    touching = GLASS.replaced(thickness_mm=1.5)
    assert sensor.replaced(cover_glass=touching).cover_glass == touching
    with pytest.raises(DesignError, match=r"front face lies 2\.1 mm in front .* only 2 mm behind"):
        sensor.replaced(cover_glass=GLASS.replaced(thickness_mm=1.6))
    with pytest.raises(DesignError, match=r"recording plane lies only 1 mm"):
        sensor.replaced(plane_distances_mm=(1.0, 22.0))
    with pytest.raises(DesignError, match=r"recording plane lies only 1\.1 mm"):
        sensor.cover_glass_at(1.1)
    assert sensor.cover_glass_at(0.0) is None


def test_there_must_be_air_behind_the_lens(covered: Lens) -> None:
    with pytest.raises(DesignError, match="there must be air behind the lens"):
        covered.with_surface(1, material="N-BK7")


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ('"N-BK7"\ndistance', '"no glass"\ndistance', MaterialError, "unknown material 'no glass'"),
        ("thickness_mm = 0.7", "thickness_mm = 0.0007", DesignError, "cover_glass, thickness_mm = 0.0007"),
        ("thickness_mm = 0.7", "thickness_mm = -0.7", DesignError, "cover_glass"),
        (
            "distance_mm = 0.5",
            "distance_mm = 1e-300",
            DesignError,
            "distance_mm: must be at least",
        ),
        ("distance_mm = 0.5", "", DesignError, "distance_mm"),
        ("distance_mm = 0.5", "distance_mm = 0.5\nwidth = 1", DesignError, "width: unknown key"),
    ],
)
def test_messages_name_the_key(
    covered: Lens, tmp_path: Path, old: str, new: str, error: type[Exception], message: str
) -> None:
    save_design(covered, tmp_path / "lens.toml")
    text = (tmp_path / "lens.toml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    (tmp_path / "lens.toml").write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(error, match=message):
        load_design(tmp_path / "lens.toml")
