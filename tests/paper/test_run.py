"""Runs: what is finished is kept, what has changed is made anew, what is cut off goes on."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from lensdesign.errors import InputError
from paper.__main__ import main
from paper.element import Element, Made, Number, Work
from paper.page import write_pages
from paper.results import inputs, kept, read_result
from paper.run import make_all, wanted
from paper.style import styled_figure

MADE: list[str] = []


@pytest.fixture(autouse=True)
def nothing_made() -> None:
    MADE.clear()


def make(work: Work) -> Made:
    """An element that notes that it was made."""
    MADE.append(work.key)
    for name, folder in work.parts.items():
        assert name == work.key or (folder / "left").exists()
    (work.folder / "left").write_text("for others", encoding="utf-8")
    figure = styled_figure(2.0, 1.0)
    figure.subplots().plot([0.0, 1.0])
    number = Number("a number", float(work.settings.get("rays", 3)), "mm", 3.0, remark="fewer rays")
    return Made((number,), ("lensdesign check",), "None.", (work.picture(figure, "A line."),))


def element(key: str, *needs: str, make: Callable[[Work], Made] = make) -> Element:
    settings = {"quick": {"rays": 2}, "full": {"rays": 3}} if key == "c" else {}
    return Element(key, f"{key}: an element", "It says so.", make, settings, needs=needs)  # type: ignore[arg-type]


ELEMENTS = {one.key: one for one in (element("a", "c"), element("b"), element("c"))}


def test_what_is_needed_comes_first_and_the_rest_in_the_papers_order() -> None:
    assert [one.key for one in wanted(ELEMENTS, ())] == ["c", "a", "b"]
    assert [one.key for one in wanted(ELEMENTS, ["a"])] == ["c", "a"]
    with pytest.raises(InputError, match=r"--only d: .*a, b, c"):
        wanted(ELEMENTS, ["b", "d"])


def test_what_is_finished_is_kept_unless_its_inputs_change(tmp_path: Path) -> None:
    make_all(ELEMENTS, tmp_path, "quick")
    assert MADE == ["c", "a", "b"]
    make_all(ELEMENTS, tmp_path, "quick")
    assert MADE == ["c", "a", "b"]
    changed = ELEMENTS | {"c": replace(ELEMENTS["c"], settings={"quick": {"rays": 1}, "full": {"rays": 3}})}
    make_all(changed, tmp_path, "quick")
    assert MADE[3:] == ["c", "a"]  # what needs it too
    (tmp_path / "pictures" / "b.png").unlink()
    make_all(changed, tmp_path, "quick")
    assert MADE[5:] == ["b"]
    make_all(changed, tmp_path, "quick", ["b"], fresh=True)
    assert MADE[6:] == ["b"]


def test_a_larger_budgets_result_will_do_and_a_smaller_one_will_not(tmp_path: Path) -> None:
    make_all(ELEMENTS, tmp_path, "full", ["c"])
    make_all(ELEMENTS, tmp_path, "quick", ["c"])
    assert MADE == ["c"]
    found = read_result(tmp_path, "c")
    assert found is not None
    assert (found.budget, found.made.numbers[0].here) == ("full", 3.0)
    make_all(ELEMENTS, tmp_path, "quick", ["c"], fresh=True)
    assert kept(tmp_path, ELEMENTS["c"], "full", ELEMENTS) is None
    # Where the budgets do not differ, one is as good as the other.
    assert inputs(ELEMENTS["b"], "quick", ELEMENTS) == inputs(ELEMENTS["b"], "full", ELEMENTS)


def test_a_run_that_is_cut_off_goes_on_behind_what_is_finished(tmp_path: Path) -> None:
    def cut_off(work: Work) -> Made:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_all(ELEMENTS | {"b": element("b", make=cut_off)}, tmp_path, "quick")
    assert {path.name for path in tmp_path.iterdir()} == {"a.json", "c.json", "pictures", "parts"}
    make_all(ELEMENTS, tmp_path, "quick")
    assert MADE == ["c", "a", "b"]


def test_results_come_back_as_they_were(tmp_path: Path) -> None:
    made = make_all(ELEMENTS, tmp_path, "quick", ["b"])
    assert [read_result(tmp_path, "b")] == made


@pytest.mark.parametrize("text", ["", "[]", '{"key": "b"}', '{"made": 3}'])
def test_a_file_that_is_no_result_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "b.json").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"b\.json: no result"):
        make_all(ELEMENTS, tmp_path, "quick")


def test_a_number_that_differs_says_why() -> None:
    assert Number("largest angle", 4.81, "°", 4.8, 0.05).agrees
    assert Number("correlation", 0.999, "", 0.99, relation=">=").agrees
    assert Number("angle", 4.0, "°", 4.8, relation="<=").agrees
    assert Number("without the paper's", 1.0).agrees is None
    with pytest.raises(ValueError, match=r"correlation: 0\.98 .*0\.99"):
        Number("correlation", 0.98, "", 0.99, relation=">=")


def test_a_zero_has_no_sign(tmp_path: Path) -> None:
    def zero(_: Work) -> Made:
        return Made((Number("a number", -0.0, "mm"),), ("lensdesign check",), "None.", ())

    elements = {"b": element("b", make=zero)}
    make_all(elements, tmp_path, "quick")
    page = write_pages(tmp_path, elements).read_text(encoding="utf-8")
    assert "| a number |  | 0\u00a0mm |" in page


def test_the_page_has_what_the_folder_has(tmp_path: Path) -> None:
    make_all(ELEMENTS, tmp_path, "quick", ["c"])
    page = write_pages(tmp_path, ELEMENTS).read_text(encoding="utf-8")
    assert "| a number | 3\u00a0mm | 2\u00a0mm | fewer rays |" in page
    assert "| a number | 3\u00a0mm | 2\u00a0mm | no | [c](#c-an-element) |" in page
    assert "(Quick budget: rays 2.)" in page
    assert "![A line.](pictures/c.png)" in page
    assert "b: an element" not in page


def test_the_documentation_has_all_of_it(tmp_path: Path) -> None:
    docs, last = tmp_path / "docs", {"c": replace(ELEMENTS["c"], documented="full")}
    make_all(ELEMENTS, tmp_path, "quick", ["c", "b"])
    with pytest.raises(InputError, match=r"lacks a .*--quick --only a$"):
        write_pages(tmp_path, ELEMENTS, docs)
    make_all(ELEMENTS, tmp_path, "quick")
    with pytest.raises(InputError, match=r"lacks c .*--only c$"):
        write_pages(tmp_path, ELEMENTS | last, docs)
    assert not docs.exists()
    write_pages(tmp_path, ELEMENTS, docs)
    beside = (tmp_path / "docs" / "paper.md").read_text(encoding="utf-8")
    assert "![A line.](images/paper/c.png)" in beside
    assert (tmp_path / "docs" / "images" / "paper" / "c.png").exists()


def test_the_command_makes_an_element_and_refuses_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["--quick", "-o", str(tmp_path / "out"), "--only", "equation-1"])
    assert (
        json.loads((tmp_path / "out" / "equation-1.json").read_text(encoding="utf-8"))["key"] == "equation-1"
    )
    assert (tmp_path / "out" / "paper.md").exists()
    with pytest.raises(SystemExit) as end:
        main(["--quick", "-o", str(tmp_path / "none"), "--only", "figure-99"])
    assert end.value.code == 2
    assert "error: --only figure-99: unknown" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
