"""Figures beside the layout: limits and perturbations in words, with units as people write them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape

import panel as pn
import pytest

from lensdesign.analysis.oversampling import oversampling_of
from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.panes.summary import as_built, findings


def shown_text(pane: pn.viewable.Viewable) -> str:
    """The text of all messages in a pane, without tags."""
    html = " ".join(str(one.object) for one in pane.select(pn.pane.HTML))
    return " ".join(unescape(re.sub(r"<[^>]*>", " ", html)).split())


@pytest.fixture(scope="module")
def settled(paper_lens: Lens) -> Iterator[Workbench]:
    """The paper's lens with all its figures."""
    bench = Workbench(paper_lens)
    try:
        bench.settle()
        yield bench
    finally:
        bench.close()


def test_limits_and_perturbations_are_named_in_words(settled: Workbench) -> None:
    shown = shown_text(as_built(settled))
    assert re.search(r"rms at most \S+ waves", shown)
    assert re.search(r"largest spread at most \S+°", shown)
    assert "decenter y" in shown
    assert not re.search(r"\w_\w|\b(deg|mm) \d+ %", shown)


def test_oversampling_ratios_are_those_of_the_check(settled: Workbench, paper_lens: Lens) -> None:
    shown = shown_text(findings(settled))
    found = oversampling_of(paper_lens, "complex")
    near, far = found.ratio_of_planes
    assert f"oversampling, complex object {near:.2f}, {far:.2f}; all planes {found.ratio:.2f}" in shown
