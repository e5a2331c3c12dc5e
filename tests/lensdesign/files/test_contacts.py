"""Surfaces that touch, or cross outside the beam, are read; what a design cannot represent is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import GOLDEN
from supplements import SENSOR

from lensdesign import InputError, load_design, save_design
from lensdesign.files.draft import LossyImportError
from lensdesign.files.zemax import read_zmx

IMPORTS = GOLDEN / "imports"
TOUCHING = (IMPORTS / "touch_at_vertex.zmx").read_text()
CROSSING = (IMPORTS / "rim_contact.zmx").read_text()


def saved(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "lens.zmx"
    path.write_text(text)
    return path


def power_by_matrices(n: float, curvatures: tuple[float, ...], distances: tuple[float, ...]) -> float:
    """Power of thick lenses of one glass in air, by ray matrices of (height, slope)."""
    matrix, index = np.eye(2), 1.0
    for i, c in enumerate(curvatures):
        behind = n if index == 1.0 else 1.0
        matrix = np.array([[1.0, 0.0], [-(behind - index) * c / behind, index / behind]]) @ matrix
        index = behind
        if i < len(distances):
            matrix = np.array([[1.0, distances[i]], [0.0, 1.0]]) @ matrix
    return float(-matrix[1, 0])


def test_lenses_that_touch_at_the_vertex_are_read(tmp_path: Path) -> None:
    found = read_zmx(IMPORTS / "touch_at_vertex.zmx", SENSOR)
    expected = power_by_matrices(1.5168000345, (0.01, -0.01, 0.01, -0.01), (4.0, 0.0, 4.0))
    assert 1.0 / found.first_order.efl_mm == pytest.approx(expected, rel=1e-6)
    assert found.dropped == ()
    assert any("surface 2 and surface 3 touch" in remark for remark in found.remarks)
    save_design(found.lens, tmp_path / "design.toml")
    assert load_design(tmp_path / "design.toml") == found.lens


def test_a_crossing_outside_the_beam_shrinks_the_clear_semi_diameters(tmp_path: Path) -> None:
    """The surfaces cross where the difference of their sags reaches the gap of 0.5 um, 3.17 mm off axis."""
    found = read_zmx(IMPORTS / "rim_contact.zmx", SENSOR)
    assert found.dropped == ()
    semis = [surface.semi_diameter_mm for surface in found.lens.surfaces]
    assert semis[1] == semis[2]
    assert semis[0] < semis[1] < (2.0 * 0.0005 / 0.0001) ** 0.5
    assert semis[3] == 8.0
    assert any("surface 2 and surface 3 cross" in remark for remark in found.remarks)
    save_design(found.lens, tmp_path / "design.toml")
    assert load_design(tmp_path / "design.toml") == found.lens


def test_a_crossing_within_the_beam_is_a_loss(tmp_path: Path) -> None:
    path = saved(tmp_path, CROSSING.replace("ENPD 5", "ENPD 8"))
    with pytest.raises(LossyImportError, match=r"surface 2 and surface 3 cross 3\.\d+ mm .* beam of 4"):
        read_zmx(path, SENSOR)
    found = read_zmx(path, SENSOR, lossy=True)
    assert found.lens.surfaces[1].semi_diameter_mm < 3.17


def test_a_crossing_next_to_the_axis_says_what_distance_the_file_needs(tmp_path: Path) -> None:
    """At the margin of the beam, the second lens would reach 2 h^2 / (2 R) into the first one."""
    text = TOUCHING.replace("CURV -0.01", "CURV 0.01", 1).replace("CURV 0.01", "CURV -0.01", 2)
    text = text.replace("CURV -0.01 0 0 0 0", "CURV 0.01 0 0 0 0", 2)
    blocks = text.split("SURF ")
    blocks[3] = blocks[3].replace("CURV 0.01", "CURV 0.02")
    blocks[4] = blocks[4].replace("CURV 0.01", "CURV -0.02").replace("CURV -0.01", "CURV -0.02")
    with pytest.raises(InputError, match=r"surface 2 and surface 3 .* at least 0\.1\d+ mm in the file"):
        read_zmx(saved(tmp_path, "SURF ".join(blocks)), SENSOR, lossy=True)


@pytest.mark.parametrize("distance", ["0", "0.0005"])
def test_messages_name_the_surfaces_of_the_file(tmp_path: Path, distance: str) -> None:
    plane = "SURF 1\n  TYPE STANDARD\n  CURV 0.0\n  DISZ 1\nSURF"
    text = CROSSING.replace("DISZ 0.0005", f"DISZ {distance}")
    for number in (5, 4, 3, 2, 1):
        text = text.replace(f"SURF {number}\n", f"SURF {number + 1}\n")
    text = text.replace("SURF 2\n  STOP", f"{plane} 2\n  STOP")
    if distance == "0":
        with pytest.raises(InputError, match="surface 3 and surface 4"):
            read_zmx(saved(tmp_path, text), SENSOR, lossy=True)
    else:
        assert any(
            "surface 3 and surface 4 cross" in r for r in read_zmx(saved(tmp_path, text), SENSOR).remarks
        )


def test_a_stop_within_the_sag_of_a_surface_is_its_aperture(tmp_path: Path) -> None:
    plane = "  TYPE STANDARD\n  CURV 0.0\n  DISZ -0.2\nSURF 2\n"
    text = CROSSING.replace("DISZ 0.0005", "DISZ 0.5")
    for number in (5, 4, 3, 2):
        text = text.replace(f"SURF {number}\n", f"SURF {number + 1}\n")
    text = text.replace("SURF 1\n  STOP\n", f"SURF 1\n  STOP\n{plane}").replace("DISZ 100", "DISZ 100.2")
    with pytest.raises(LossyImportError, match=r"the stop lies 0\.2 mm behind the vertex of surface 2"):
        read_zmx(saved(tmp_path, text), SENSOR)
    found = read_zmx(saved(tmp_path, text), SENSOR, lossy=True)
    assert found.lens.object.working_distance_mm == pytest.approx(100.0)
    assert found.lens.stop_index == 0
    assert len(found.lens.surfaces) == 4


def test_a_crossing_may_clip_the_stop(tmp_path: Path) -> None:
    text = CROSSING.replace("ENPD 5", "ENPD 8").replace("  STOP\n", "")
    text = text.replace("SURF 2\n", "SURF 2\n  STOP\n")
    found = read_zmx(saved(tmp_path, text), SENSOR, lossy=True)
    assert found.lens.stop_index == 1
    assert found.lens.stop_semi_diameter_mm < 3.17
    assert any("cross" in loss for loss in found.dropped)
