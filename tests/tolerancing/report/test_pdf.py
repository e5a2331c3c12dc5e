"""Pages are filled: files stand in two columns, and a figure shrinks a little to stay on its page."""

import re
import tomllib

from matplotlib.figure import Figure

from tolerancing.report.blocks import Code, FigureBlock, Panel, Paragraph, Report
from tolerancing.report.pdf import wrapped_code, write_pdf


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


def test_wrapped_files_stay_files():
    """Comments behind the code stay comments, and no line is longer than a column."""
    text = """\
# Starting tolerances, to be edited: check each against the shop that makes and mounts the lens.
title = "a # b"
kind = "reconstruction_loss"              # axis, 0.7 of the half field
parameter = "conic"                       # equivalent to the irregularity
level = "pupil"                           # from rays; wave is slower, auto compares both
"""
    width = 55
    wrapped = [part for line in text.splitlines() for part in wrapped_code(line, width)]
    assert max(map(len, wrapped)) <= width
    assert tomllib.loads("\n".join(wrapped)) == tomllib.loads(text)
    assert 'parameter = "conic"  # equivalent to the irregularity' in wrapped
