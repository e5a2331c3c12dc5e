"""The front as a page and a picture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from lensdesign.exploration import ExploredPoint, axes_of
from lensdesign.exploration.chart import SERIES, front_page, write_charts
from lensdesign.exploration.front import MAX_GLASSES
from lensdesign.optimization import Specification


def test_each_lens_tells_its_name_and_values(
    specification: Specification, explored: list[ExploredPoint]
) -> None:
    axes = axes_of("thickness,spread", specification)
    hostile = replace(explored[0], key="<script>alert(1)</script>", glasses="<b>")
    page = front_page([hostile, *explored[1:]], axes)
    assert "<script>" not in page and "<b>" not in page  # noqa: PT018
    drawing = ElementTree.fromstring(page[page.index("<svg") : page.index("</svg>") + 6])
    titles = [title.text or "" for title in drawing.iter("title")]
    assert len(titles) == len([one for one in explored if one.lens is not None])
    for one in explored[1:]:
        assert any(one.key in title and f"{one.values['thickness_mm']:.5g}" in title for title in titles)
    places = [(float(c.get("cx") or 0.0), float(c.get("cy") or 0.0)) for c in drawing.iter("circle")]
    assert all(0.0 < x < 860.0 and 0.0 < y < 520.0 for x, y in places)


def test_a_picture_and_a_page_are_written(
    tmp_path: Path, specification: Specification, explored: list[ExploredPoint]
) -> None:
    files = write_charts(tmp_path, explored, axes_of("thickness,spread", specification))
    assert [file.name for file in files] == ["front.png", "front.html"]
    assert files[0].read_bytes().startswith(b"\x89PNG")


def test_every_choice_of_glasses_has_a_colour_of_its_own() -> None:
    assert len(set(SERIES)) >= MAX_GLASSES
