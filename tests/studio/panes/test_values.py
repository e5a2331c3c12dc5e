"""The panes without a browser: messages of the page, and text that stays text."""

from __future__ import annotations

import time

import pytest
from bokeh.document import Document

from lensdesign import Lens
from studio import Workbench, panes, studio
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
    pane = panes.what_if(bench)
    pane._handle_msg({"key": "lens.tilt_x_deg", "text": "0.1"})
    assert bench.what_if.values == {"lens.tilt_x_deg": 0.1}
    pane._handle_msg({"key": "environment.temperature_c", "text": "-400"})
    assert "environment.temperature_c" in pane.refused
    pane._handle_msg({"action": "reset", "group": "lens"})
    assert bench.what_if.values == {}
    bench.close()


@pytest.mark.parametrize("name", [name for name in panes.__all__ if name not in ("wavefront", "footprint")])
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
