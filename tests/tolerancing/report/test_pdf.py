"""Pages are filled: files stand in two columns, and a figure shrinks a little to stay on its page."""

import re

from matplotlib.figure import Figure

from tolerancing.report.blocks import Code, FigureBlock, Panel, Paragraph, Report
from tolerancing.report.pdf import write_pdf


def pages(path, *blocks):
    write_pdf(Report("title", "subtitle", blocks, {}, "footer"), path)
    return len(re.findall(rb"/Type /Page\b(?!s)", path.read_bytes()))


def test_a_long_file_takes_half_of_the_pages(tmp_path):
    lines = Code("\n".join(f"key_{number} = {number}" for number in range(300)))
    # 85 lines go into a column.
    assert pages(tmp_path / "a.pdf", lines) == 2
    assert pages(tmp_path / "a.pdf", Code("\n".join(["x" * 400] * 100))) > 3
    assert pages(tmp_path / "a.pdf", Code("one line")) == 1


def test_a_lone_figure_shrinks_so_as_to_stay_on_its_page(tmp_path):
    panel = Panel(Figure(figsize=(7.0, 4.5)), "nothing")
    above, below = ([Paragraph(f"line {number}") for number in range(count)] for count in (24, 28))
    # On a page of its own it would push what follows to a third one.
    assert pages(tmp_path / "a.pdf", *above, FigureBlock((panel,), caption="a figure"), *below) == 2
