"""Pictures of few dots, where it is not pictures that are tested: they are drawn sooner."""

from __future__ import annotations

from functools import partial

import pytest

from lensdesign.plots import plots, scene3d
from wavesim.plots import frames


def draw_few_dots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands of this process draw small pictures without ticks, in Matplotlib's first layout.

    A better layout draws all words up to three times, and ticks take most of the time of drawing.
    """
    monkeypatch.setattr(plots, "DOTS_PER_INCH", 40)
    monkeypatch.setattr(plots, "render_lens", partial(scene3d.render_lens, window_size_px=(300, 200)))
    monkeypatch.setattr(frames, "DPI", 40)
    monkeypatch.setattr("matplotlib.layout_engine.ConstrainedLayoutEngine.execute", lambda *_: {})
    monkeypatch.setattr("matplotlib.axis.Axis.draw", lambda *_: None)
