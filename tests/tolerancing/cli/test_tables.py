"""No table cuts a name or a number."""

import pytest

from lensdesign.cli import tables
from tolerancing.cli.tables import print_table
from wavesim.cli import runs

NAMES = [f"coarse_contrast_of_the_edge_of_the_field_{axis}" for axis in "xy"]


def by_lensdesign(rows):
    table = tables.table("title", "constraint", "value", "")
    for row in rows:
        table.add_row(*row)
    tables.print_tables(table)


@pytest.mark.parametrize("columns", [44, 80, 120])
@pytest.mark.parametrize(
    "draw",
    [
        lambda rows: print_table("title", ["name"], ["value", "other"], rows),
        lambda rows: runs.print_table(["name"], ["value", "other"], rows),
        by_lensdesign,
    ],
    ids=["tolerancing", "wavesim", "lensdesign"],
)
def test_names_go_on_below_and_numbers_stay_whole(draw, columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    draw([(name, "-0.0161 mm", "12.345") for name in NAMES])
    shown = capsys.readouterr().out
    assert "…" not in shown
    assert max(map(len, shown.splitlines())) <= columns
    assert shown.count("-0.0161 mm") == shown.count("12.345") == 2
    firsts = "".join(line.strip("│ ").split("  ")[0].split(" │")[0].strip() for line in shown.splitlines())
    for name in NAMES:
        assert name in firsts


def test_names_are_whole_where_there_is_space(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    name = "surface_1_irregularity_pv_waves"
    print_table(
        "title",
        ["perturbation", "sentence"],
        ["change"],
        [(name, "words that are wrapped " * 4, "1.0")],
    )
    lines = capsys.readouterr().out.splitlines()
    assert any(name in line for line in lines)
    assert max(map(len, lines)) <= 80
