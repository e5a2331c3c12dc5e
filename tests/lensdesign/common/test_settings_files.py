"""Options of commands in files, and the settings that results are stored with."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import pytest
import tomli_w
import typer
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from lensdesign.common.console import make_app
from lensdesign.common.options import Json, output_option
from lensdesign.errors import InputError

Run = Callable[..., dict[str, Any]]


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


CALLS: list[dict[str, Any]] = []


def make() -> typer.Typer:
    app = make_app("Test.", {"All": {"make": "Make.", "other": "Other."}})

    @app.command("make")
    def make_things(
        design: Annotated[Path, typer.Argument(metavar="DESIGN")],
        factor: Annotated[float, typer.Argument(metavar="FACTOR")],
        output: Annotated[Path, output_option("Folder.", "DIR", is_folder=True)],
        number: float = 1.5,
        count: Annotated[int, typer.Option(min=0)] = 3,
        text: str = "plain",
        lines: Annotated[str, typer.Option("--lines-um", metavar="NUMBER,...")] = "1,2",
        object_: Annotated[str, typer.Option("--object", metavar="[usaf|star]|FILE")] = "usaf",
        pair: Annotated[tuple[int, int] | None, typer.Option()] = None,
        catalog: Annotated[list[Path] | None, typer.Option()] = None,
        colour: Colour = Colour.RED,
        noise: bool = True,
        level: Annotated[float, typer.Option("--level", "--old-level")] = 0.0,
        trust: Annotated[bool, typer.Option("--trust")] = False,
        as_json: Json = False,
    ) -> None:
        values = dict(locals())
        if number < 0.0:
            raise InputError(f"--number = {number:g}: must not be negative")
        output.mkdir(parents=True, exist_ok=True)
        CALLS.append({key: value for key, value in values.items() if key != "output"})
        raise typer.Exit(1 if number == 1.0 else 0)

    @app.command()
    def other(frames: Annotated[list[Path], typer.Argument(metavar="FRAMES...")], seed: int = 0) -> None:
        CALLS.append({"frames": frames, "seed": seed})

    return app


APP = make()


def call(*arguments: object) -> dict[str, Any]:
    """Run a command, and return the values that its function received."""
    CALLS.clear()
    result = CliRunner().invoke(APP, [str(one) for one in arguments])
    if isinstance(result.exception, Exception) and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code in (0, 1), result.output
    return CALLS[-1]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        path = tmp_path / "run.toml"
        path.write_text(text)
        return path

    return write


def test_values_of_a_file_are_defaults_and_paths_start_at_it(write: Any, tmp_path: Path) -> None:
    file = write(
        'design = "lens.toml"\nfactor = 2\nnumber = 3\nlines-um = [0.5, 2]\nobject = "own.png"\n'
        'pair = [4, 5]\ncatalog = ["a.agf", "/b.agf"]\ncolour = "blue"\n'
        "noise = false\nold-level = -2.5\n[other]\nseed = 9\n"
    )
    out = tmp_path / "out"
    found = call("make", "--settings", file, "-o", out, "--number", 4)
    assert found == {
        "design": tmp_path / "lens.toml", "factor": 2.0, "number": 4.0, "count": 3, "text": "plain",
        "lines": "0.5,2", "object_": str(tmp_path / "own.png"), "pair": (4, 5),
        "catalog": [tmp_path / "a.agf", Path("/b.agf")], "colour": Colour.BLUE, "noise": False, "level": -2.5,
        "trust": False, "as_json": False,
    }  # fmt: skip
    assert call("make", "mine.toml", f"--settings={file}", "-o", out, 7)["design"] == Path("mine.toml")
    with pytest.raises(InputError, match="nothing for"):
        call("other", "--settings", write("[make]\nnumber = 3\n"), "a.tif")
    assert call("other", "--settings", write('[other]\nframes = ["c.tif"]'))["frames"] == [tmp_path / "c.tif"]
    assert call("other", "a.tif", "b.tif", "--settings", file.with_name("run.toml"))["frames"] == [
        Path("a.tif"), Path("b.tif"),
    ]  # fmt: skip


def test_an_argument_that_the_file_states_is_left_out(write: Any, tmp_path: Path) -> None:
    file = write("factor = -2.5\n")
    found = call("make", "mine.toml", "--settings", file, "-o", tmp_path / "out")
    assert (found["design"], found["factor"]) == (Path("mine.toml"), -2.5)
    file = write('design = "lens.toml"\nfactor = 4\n')
    found = call("make", "--settings", file, "-o", tmp_path / "out", "--", "mine.toml")
    assert (found["design"], found["factor"]) == (Path("mine.toml"), 4.0)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("numbr = 1", ("numbr (did you mean number?)", "allowed: design, factor, number, count")),
        ("lines_um = [1]", ("lines_um (did you mean lines-um?)",)),
        ("number = 'x'", ("number = 'x'", "must be a number")),
        ("number = true", ("number = True", "must be a number")),
        ("count = 1.5", ("count = 1.5", "must be a whole number")),
        ("count = -1", ("count = -1", "0")),
        ("noise = 1", ("noise = 1", "must be true or false")),
        ("text = 1", ("text = 1", "must be a text")),
        ("lines-um = true", ("lines-um = True", "or an array of values")),
        ("pair = [1]", ("pair = [1]", "must be an array of 2")),
        ("catalog = 'a'", ("catalog = 'a'", "must be an array")),
        ("colour = 3", ("colour = 3", "red, blue")),
        ("colour = 'green'", ("colour = 'green'", "red")),
        ("level = 1\nold-level = 2", ("give level or old-level",)),
        ("trust = true", ("trust: a file cannot set it",)),
        ("output = 'a'", ("output: a file cannot set it",)),
        ("settings = 'a'", ("settings: a file cannot set it",)),
        ("number = -1", ("--number = -1", "(number: set in ")),
        ("[other]\nseed = 'x'\n[make]\nnumber = 2", ("[other] seed = 'x'",)),
        ("[elsewhere]\nseed = 1", ("elsewhere", "allowed")),
        ("= 1", ("not valid TOML",)),
    ],
)
def test_a_fault_is_a_message_with_file_key_and_what_is_allowed(
    write: Any, tmp_path: Path, text: str, parts: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as refused:
        call("make", "a.toml", 2, "-o", tmp_path / "out", "--settings", write(text))
    for part in ("run.toml", *parts):
        assert part in str(refused.value)
    assert not (tmp_path / "out").exists()


def test_help_does_not_read_the_file() -> None:
    assert CliRunner().invoke(APP, ["make", "--settings", "none.toml", "-h"]).exit_code == 0


texts = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FF, exclude_characters="\x7f"))
finite = st.floats(allow_nan=False, allow_infinity=False)
options = st.fixed_dictionaries(
    {},
    optional={
        "number": finite.filter(lambda x: x >= 0.0),
        "count": st.integers(0, 2**60),
        "text": texts,
        "lines-um": st.lists(finite, min_size=1),
        "object": st.sampled_from(["usaf", "star", "-own.png", "folder/x y.png"]),
        "pair": st.tuples(st.integers(), st.integers()).map(list),
        "catalog": st.lists(st.sampled_from(["a.agf", "../b.agf", "-c.agf"]), min_size=1),
        "colour": st.sampled_from(["red", "blue"]),
        "noise": st.booleans(),
        "level": finite,
    },
)


@hypothesis_settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(options)
def test_the_stored_settings_repeat_the_run_from_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chosen: dict[str, Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("run.toml").write_text(tomli_w.dumps(chosen), encoding="utf-8")
    first = call("make", "lens.toml", "--settings", "run.toml", "-o", "deep/a", "--", -2)
    stored = Path("deep/a/settings.toml").resolve()
    Path("elsewhere").mkdir(exist_ok=True)
    monkeypatch.chdir("elsewhere")
    again = call("make", "--settings", stored, "-o", "b")

    def absolute(values: dict[str, Any]) -> dict[str, Any]:
        fixed = {"design": (tmp_path / values["design"]).resolve()}
        if values["object_"] not in ("usaf", "star"):
            fixed["object_"] = (tmp_path / values["object_"]).resolve()
        if values["catalog"]:
            fixed["catalog"] = [(tmp_path / one).resolve() for one in values["catalog"]]
        return values | fixed

    assert absolute(again) == absolute(first)
    data, repeated = (tomllib.loads(p.read_text(encoding="utf-8")) for p in (stored, Path("b/settings.toml")))
    assert data["make"].keys() == repeated["make"].keys()
    assert "output" not in data["make"]
    assert stored.read_text(encoding="utf-8").startswith("# Settings of the results in this folder")
