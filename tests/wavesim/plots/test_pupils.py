"""The sheet on a pupil: titles keep to their charts, and lengths are in µm."""

from __future__ import annotations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

from lensdesign import Lens
from lensdesign.lens.poses import Pose
from wavesim import PupilSampler, refocus
from wavesim.plots.pupils import pupil_figure


def test_titles_do_not_overrun_and_say_micrometres(paper_lens: Lens) -> None:
    pupil = refocus(PupilSampler(paper_lens, samples=48).pupil(Pose(decenter_y_mm=0.03))).pupil
    figure = pupil_figure(pupil, [1.55, 0.775, 0.6], "A lens\nlens: decenter y 0.03 mm")
    FigureCanvasAgg(figure).draw()
    titles = [axes.title for axes in figure.axes if axes.get_title()]
    boxes = [Text.get_window_extent(title) for title in titles]
    for title, box in zip(titles, boxes, strict=True):
        assert title.axes is not None
        assert box.width <= title.axes.bbox.width, title.get_text()
        assert sum(box.overlaps(other) for other in boxes) == 1
    shown = " ".join(text.get_text() for text in figure.findobj(Text))
    assert " um" not in shown
    assert "(um)" not in shown
    assert "x (µm)" in shown
