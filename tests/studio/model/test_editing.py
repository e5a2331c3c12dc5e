"""A design as it is edited: changes, refusals, undoing and redoing."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import DESIGNS

from lensdesign import load_design
from lensdesign.errors import InputError
from studio.model.document import opened
from studio.model.editing import (
    Editing,
    value_at,
    with_shape,
    with_stop,
    with_surface_after,
    with_term,
    with_value,
    without_surface,
)

RADIUS = ("surface", 1, "radius_mm")


def paper() -> Editing:
    return opened(DESIGNS / "paper_singlet.toml")[1]


def changed(editing: Editing, radius: float, gesture: str = "") -> Editing:
    return editing.changed(with_value(editing.now.tables, RADIUS, radius), "radius", gesture)


def test_an_edit_gives_the_lens_of_the_file_with_that_value(tmp_path: Path) -> None:
    text = (DESIGNS / "paper_singlet.toml").read_text().replace("radius_mm = -12.0", "radius_mm = -12.5")
    file = tmp_path / "other.toml"
    file.write_text(text)
    assert changed(paper(), -12.5).lens == load_design(file)


@pytest.mark.parametrize(
    ("table_path", "value"),
    [
        (RADIUS, 0.0),
        (("surface", 0, "material"), "N-BK77"),
        (("surface", 0, "thickness_mm"), -1.0),
        (("object", "numerical_aperture"), 1.5),
        (("wavelengths_um", 0), 99.0),
    ],
)
def test_a_bad_value_is_refused_in_the_words_of_the_command(
    tmp_path: Path, table_path: tuple[str | int, ...], value: object
) -> None:
    import tomli_w

    editing = paper()
    tables = with_value(editing.now.tables, table_path, value)
    file = tmp_path / "bad.toml"
    file.write_text(tomli_w.dumps(tables))
    with pytest.raises(InputError) as of_command:
        load_design(file)
    with pytest.raises(InputError) as of_page:
        editing.changed(tables, "bad")
    assert str(of_page.value).replace(str(editing.path), str(file)) == str(of_command.value)
    assert editing.lens == load_design(DESIGNS / "paper_singlet.toml")


def test_a_gesture_is_undone_as_one() -> None:
    editing = paper()
    for radius in (-12.1, -12.2, -12.3):
        editing = changed(editing, radius, "drag 1")
    editing = changed(editing, -12.4, "drag 2")
    back = editing.undone()
    assert value_at(back.now.tables, RADIUS) == -12.3
    assert value_at(back.undone().now.tables, RADIUS) == -12.0
    assert back.undone().undone() is back.undone() or not back.undone().undo_steps
    assert back.redone().now is editing.now


@given(st.lists(st.sampled_from(["undo", "redo", "edit"]), max_size=30))
def test_undoing_and_redoing_is_a_walk_along_one_line(moves: list[str]) -> None:
    """Against a list and a position in it."""
    editing, line, at = paper(), [-12.0], 0
    for k, move in enumerate(moves):
        if move == "edit":
            radius = -12.0 - 0.01 * (k + 1)
            editing, line, at = changed(editing, radius), [*line[: at + 1], radius], at + 1
        elif move == "undo":
            editing, at = editing.undone(), max(at - 1, 0)
        else:
            editing, at = editing.redone(), min(at + 1, len(line) - 1)
        assert editing.lens.surfaces[1].radius_mm == line[at]


def test_surfaces_come_and_go() -> None:
    editing = paper()
    more = editing.changed(with_surface_after(editing.now.tables, 0), "add")
    assert [s.material for s in more.lens.surfaces] == ["N-BK7", "N-BK7", None]
    assert more.lens.exit_vertex_z_mm == pytest.approx(9.7)
    behind = more.changed(with_surface_after(more.now.tables, 2), "add")
    assert len(behind.lens.surfaces) == 4
    moved = editing.changed(with_stop(editing.now.tables, 1), "stop")
    assert moved.lens.stop_index == 1
    with pytest.raises(InputError, match="is the stop"):
        without_surface(editing.now.tables, 0)
    sized = more.changed(with_stop(more.now.tables, 1), "stop on a surface without a size")
    assert sized.lens.stop_semi_diameter_mm == 8.26
    assert more.changed(without_surface(more.now.tables, 1), "less").lens.surfaces[0].thickness_mm == 4.85


def test_a_shape_keeps_what_it_shares_with_the_one_before() -> None:
    toroid = with_value(with_shape(paper().now.tables, 1, "toroid"), ("surface", 1, "radius_x_mm"), -20.0)
    biconic = with_shape(toroid, 1, "biconic")["surface"][1]
    assert (biconic["radius_mm"], biconic["radius_x_mm"]) == (-12.0, -20.0)
    assert biconic["conic_x"] == biconic["conic"]


def test_each_shape_has_terms_of_its_own() -> None:
    for shape, key in (("odd asphere", "odd_asphere"), ("toroid", "asphere"), ("Qbfs", "q_mm")):
        surface = with_term(with_shape(paper().now.tables, 1, shape), 1)["surface"][1]
        assert surface["shape"] == shape
        assert len(surface[key]) >= 1
        editing = paper()
        assert editing.changed(with_shape(editing.now.tables, 1, shape), "shape", "").lens is not None
