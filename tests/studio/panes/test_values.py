"""The panes without a browser: messages of the page, and text that stays text."""

from __future__ import annotations

import time

import pytest
from bokeh.document import Document

from lensdesign import Lens
from studio import Workbench, panes, studio
from studio.model.whatif import WhatIf
from studio.panes.values import ValueTable

HOSTILE = "<img src=x onerror=alert(1)>"


@pytest.fixture
def bench(paper_lens: Lens) -> Workbench:
    made = Workbench(paper_lens.replaced(title=HOSTILE), "")
    made.settle()
    return made


def test_rows_are_edited_by_messages(bench: Workbench) -> None:
    pane = panes.surfaces(bench)
    pane._handle_msg({"key": "surface.1.conic", "kind": "number", "text": "-0.9", "gesture": "a"})
    assert bench.lens.surfaces[1].conic == -0.9
    pane._handle_msg({"key": "surface.1.conic", "kind": "number", "text": HOSTILE, "gesture": ""})
    assert bench.refused == {"surface.1.conic": f"'{HOSTILE}': must be a number"}
    assert pane.refused == bench.refused
    pane._handle_msg({"search": "N-BK"})
    assert "N-BK7" in pane.glasses
    pane._handle_msg({"action": "add", "group": "surface 1"})
    assert len(bench.lens.surfaces) == 3
    pane._handle_msg("nonsense")
    bench.close()


def test_what_is_off_is_set_and_put_back(bench: Workbench) -> None:
    (pane,) = panes.what_if(bench).select(ValueTable)
    pane._handle_msg({"key": "lens.tilt_x_deg", "text": "0.1"})
    assert bench.what_if.values == {"lens.tilt_x_deg": 0.1}
    pane._handle_msg({"key": "environment.temperature_c", "text": "-400"})
    assert "environment.temperature_c" in pane.refused
    pane._handle_msg({"action": "reset", "group": "lens"})
    assert bench.what_if.values == {}
    bench.close()


def test_the_strip_names_what_is_off_and_resets_it(bench: Workbench) -> None:
    strip = panes.deviations(bench)
    assert strip.words == ""
    bench.set_what_if(WhatIf({"lens.decenter_y_mm": 0.03, "surface 2.radius_percent": 0.1}))
    assert strip.words == "decenter y 0.03 mm, radius 2 0.1 %"
    strip._handle_msg({"action": "reset"})
    assert strip.words == ""
    bench.close()


def test_panes_of_a_lens_that_cannot_be_traced_are_greyed_with_the_reason(bench: Workbench) -> None:
    shown = [panes.layout(bench), panes.spread(bench), panes.wavefront(bench), panes.patch(bench)]
    shown += [
        panes.findings(bench),
        panes.point_spread(bench),
        panes.modulation(bench),
        panes.contrast(bench),
    ]
    assert [pane.reason for pane in shown] == [""] * len(shown)
    bench.edit("surface.1.semi_diameter_mm", "number", "0.04")
    bench.settle()
    for pane in shown[1:]:
        assert "ray" in pane.reason
        assert pane.reason in pane.note.object
        assert pane.note.visible
        assert pane.contents.styles["opacity"] == "0.3"
    bench.undo()
    bench.settle()
    assert [pane.reason for pane in shown] == [""] * len(shown)
    assert not shown[1].note.visible
    assert "opacity" not in shown[1].contents.styles
    bench.close()


def test_the_table_of_surfaces_edits_flags_and_bounds(bench: Workbench) -> None:
    table = panes.surface_table(bench)
    assert [row["name"] for row in table.rows] == [
        "object",
        "surface 1",
        "surface 2",
        "sensor H1",
        "sensor H2",
    ]
    radius = table.rows[2]["cells"][0]
    assert (radius["text"], radius["varied"], radius["range"]) == ("-12", True, ["10.1"])
    table._handle_msg({"key": "surface.1.radius_mm", "kind": "number", "text": "-12.5"})
    assert bench.lens.surfaces[1].radius_mm == -12.5
    table._handle_msg({"varied": "surface 2 radius_mm", "is_varied": False})
    assert "surface 2 radius_mm" not in bench.session.varied
    table._handle_msg({"bounds": "surface 1 thickness_mm", "texts": ["9", "8"]})
    assert "less than" in table.refused["surface 1 thickness_mm"]
    table._handle_msg({"bounds": "surface 1 thickness_mm", "texts": ["9", "11"]})
    assert table.refused == {}
    assert bench.session.ranges == {"surface 1 thickness_mm": (9.0, 11.0)}
    table._handle_msg({"surface": 1, "shape": "even asphere"})
    table._handle_msg({"action": "term", "group": "surface 2"})
    assert bench.lens.surfaces[1].asphere == (0.0, 0.0)
    assert table.columns[-2:] == ["r^4", "r^6"]
    table._handle_msg({"surface": 1, "shape": "biconic"})
    assert bench.lens.surfaces[1].radius_x_mm == -12.5
    table._handle_msg({"surface": 1, "shape": "Qbfs"})
    table._handle_msg({"action": "term", "group": "surface 2"})
    assert (bench.lens.surfaces[1].kind, bench.lens.surfaces[1].q_mm) == ("sphere", (0.0, 0.0))
    assert table.columns[-3:] == ["norm. radius (mm)", "Q0 (mm)", "Q1 (mm)"]
    table._handle_msg({"key": "surface.1.q_mm.1", "kind": "number", "text": "0.001"})
    assert bench.lens.surfaces[1].q_mm == (0.0, 0.001)
    table._handle_msg({"surface": 1, "shape": "conic"})
    assert bench.lens.surfaces[1].shape_class.NAME == "conic"
    table._handle_msg({"key": "surface.1.conic", "kind": "number", "text": HOSTILE})
    assert HOSTILE in table.refused["surface.1.conic"]
    bench.close()


@pytest.mark.parametrize(
    "name", [name for name in panes.__all__ if name not in ("wavefront", "point_spread", "footprint")]
)
def test_each_pane_can_be_used_alone(bench: Workbench, name: str) -> None:
    pane = getattr(panes, name)(bench)
    document = Document()
    for root in [pane.get_root(document)]:
        document.add_root(root)
    assert HOSTILE not in str(document.to_json()) or name == "surfaces"
    bench.close()


def test_a_notebook_has_the_same_panes(paper_lens: Lens) -> None:
    view = studio(paper_lens, "")
    assert len(view.select(ValueTable)) >= 1
    end = time.monotonic() + 60
    while not view.select(lambda part: "met" in str(getattr(part, "object", ""))):
        assert time.monotonic() < end
        time.sleep(0.05)
