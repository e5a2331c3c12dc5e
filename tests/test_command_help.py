"""Help of all commands: groups of options, the short help, widths and choices."""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any, get_args

import pytest
import typer
from typer.main import get_command

from lensdesign.common.help_pages import MOST_OPTIONS
from lensdesign.common.option_groups import OptionGroup
from lensdesign.optimization.nlopt_driver import ALGORITHMS
from tolerancing.perturbations.grades import GRADES
from wavesim.cli.options import with_settings
from wavesim.engines.registry import AUTO, ENGINES
from wavesim.engines.slices.engine import CompensationKind
from wavesim.engines.slices.planes import Spacing
from wavesim.engines.wpm.engine import Interface
from wavesim.scene.settings import STARTS, CalibrationSettings, ReconstructionSettings

APPS = {
    package: get_command(import_module(f"{package}.cli.commands").app)
    for package in ("lensdesign", "wavesim", "tolerancing")
}
COMMANDS = [f"{package} {name}" for package, app in APPS.items() for name in app.commands]
every_command = pytest.mark.parametrize("command", COMMANDS)
ROW = re.compile(r"^  (-\w, )?--\w")
"""Line of the help at which an option begins."""


def command_of(command: str) -> Any:
    package, name = command.split()
    return APPS[package].commands[name]


@pytest.fixture
def help_of(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Return a function that runs a command with arguments and returns what it prints."""
    monkeypatch.setenv("COLUMNS", "80")

    def run(command: str, *arguments: str) -> str:
        package, name = command.split()
        APPS[package].main([name, *arguments], prog_name=package, standalone_mode=False)
        return capsys.readouterr().out

    return run


def sections_of(text: str) -> dict[str, list[str]]:
    """Return the rows of options below each title; rows without a title below an empty one."""
    sections: dict[str, list[str]] = {}
    title = ""
    for line in text.splitlines():
        if re.match(r"^\S.*:$", line):
            title = line.removesuffix(":")
        elif ROW.match(line):
            sections.setdefault(title, []).append(line.strip())
    return sections


def names_of(row: str) -> list[str]:
    """Return the names of the options of a row."""
    return re.findall(r"(?:^|(?<=, )|(?<=/ ))(--?[a-z][\w-]*)", row.split("  ")[0])


@pytest.mark.parametrize("package", APPS)
def test_every_command_is_listed_once_with_all_words(
    package: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    app = APPS[package]
    listed = [name for commands in app.contents.values() for name in commands]
    assert sorted(listed) == sorted(app.commands)
    monkeypatch.setenv("COLUMNS", "80")
    app.main(["-h"], prog_name=package, standalone_mode=False)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    for title, commands in app.contents.items():
        assert f"{title}:".split() in lines
        for name, text in commands.items():
            assert [name, *text.split()] in lines


@every_command
def test_the_short_help_has_few_options(command: str, help_of: Any) -> None:
    assert "\n  --settings FILE " in help_of(command, "-h")
    text, whole = help_of(command, "-h"), help_of(command, "--help-all")
    shown = [row for rows in sections_of(text).values() for row in rows]
    assert len(shown) <= MOST_OPTIONS
    assert help_of(command, "--help") == text
    if text != whole:
        assert text.splitlines()[-1] == f"More options: {command} --help-all"
        assert len(command_of(command).params) > MOST_OPTIONS - 1
    assert "More options" not in whole


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (
            "wavesim image",
            "output object patch-mm plane-distance-mm illumination exposures noise engine json",
        ),
        ("wavesim reconstruct", "design output patch-mm kind iterations calibration calibrate truth engine"),
        ("wavesim calibrate", "design output patch-mm parameters truth empty priors engine json"),
    ],
)
def test_the_short_help_has_what_most_people_need(command: str, names: str, help_of: Any) -> None:
    shown = {
        name
        for rows in sections_of(help_of(command, "-h")).values()
        for row in rows
        for name in names_of(row)
    }
    assert {f"--{name}" for name in names.split()} <= shown


MAIN_COMMANDS = {
    "lensdesign": ("check", "compare", "drawing", "export", "import", "limits", "optimize", "scale"),
    "wavesim": ("calibrate", "choose-engine", "image", "pupil", "reconstruct"),
    "tolerancing": ("predict", "run", "show", "start"),
}


@pytest.mark.parametrize("command", [f"{package} {n}" for package, own in MAIN_COMMANDS.items() for n in own])
def test_the_example_of_a_command_is_one_that_it_accepts(command: str) -> None:
    found = command_of(command)
    (example,) = re.findall(r"^ *Example: (.*)$", found.callback.__doc__, re.MULTILINE)
    package, name, *arguments = example.split()
    assert f"{package} {name}" == command
    context = typer.Context(found, info_name=name, help_option_names=["-h", "--help"])
    values, extra, _ = found.make_parser(context).parse_args(arguments)
    assert not extra
    required = {p.name for p in found.params if p.required}
    assert required <= {key for key, value in values.items() if value not in (None, ())}


@every_command
def test_the_whole_help_has_every_option_once_below_a_title(command: str, help_of: Any) -> None:
    sections = sections_of(help_of(command, "--help-all"))
    assert set(sections) <= set(OptionGroup)
    assert list(sections) == [title for title in OptionGroup if title in sections]
    shown = [name for rows in sections.values() for row in rows for name in names_of(row)]
    options = [p for p in command_of(command).params if p.param_type_name == "option"]
    # Former names keep working, and are not shown.
    shown_of = [
        [*[n for n in p.opts if n.startswith("--")][:1], *[n for n in p.opts if n[1] != "-"]] for p in options
    ]
    expected = [name for p, own in zip(options, shown_of, strict=True) for name in (*own, *p.secondary_opts)]
    assert sorted(shown) == sorted([*expected, "-h", "--help", "--help-all"])


@every_command
@pytest.mark.parametrize("option", ["-h", "--help-all"])
def test_no_line_is_wide_and_no_name_is_broken(command: str, option: str, help_of: Any) -> None:
    for line in help_of(command, option).splitlines():
        assert len(line) <= 80
        assert not line.endswith("-"), line


@every_command
def test_most_used_options_are_options(command: str) -> None:
    found = command_of(command)
    options = [p.name for p in found.params if p.param_type_name == "option"]
    names = getattr(found.callback, "most_used", ())
    assert set(names) <= set(options)
    assert len(names) < MOST_OPTIONS - 1
    assert "settings_file" not in names  # every short help shows it
    assert bool(names) == (len(options) + 1 > MOST_OPTIONS)
    required = [p.name for p in found.params if p.param_type_name == "option" and p.required]
    assert not names or set(required) <= set(names)


def choices(*words: str) -> str:
    return f"[{'|'.join(words)}]"


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("wavesim image", "--illumination [plane|tilted|gaussian|point|speckle]|FILE"),
        ("wavesim image", "--object [usaf|star|phase|tissue|empty]|FILE"),
        ("wavesim image", "--ground [bright|dark]"),
        ("wavesim image", f"--engine {choices(AUTO, *ENGINES)}"),
        ("wavesim calibrate", f"--engine {choices(AUTO, *ENGINES)}"),
        ("wavesim image", f"--compensation {choices(*get_args(CompensationKind))}"),
        ("wavesim image", f"--interface {choices(*get_args(Interface))}"),
        ("wavesim resolve-lines", f"--spacing {choices(*get_args(Spacing))}"),
        ("wavesim resolve-lines", f"--reference {choices(*ENGINES)}"),
        ("wavesim reconstruct", "--kind [complex|amplitude|phase]"),
        ("wavesim reconstruct", "--method [paper|object]"),
        ("wavesim reconstruct", f"--start {choices(*STARTS['paper'], *STARTS['object'])}"),
        ("wavesim reconstruct", "--tv-weight NUMBER|auto"),
        ("wavesim reconstruct", "--usaf [bright|dark]"),
        ("lensdesign draw", "--format [png|svg]"),
        ("lensdesign optimize", f"--algorithm {choices(*ALGORITHMS)}"),
        ("lensdesign studio", f"--tolerances {choices(*GRADES)}|STUDY"),
        ("tolerancing start", f"--grade {choices(*GRADES)}"),
    ],
)
def test_choices_are_shown(command: str, shown: str, help_of: Any) -> None:
    assert shown.replace(" ", "") in re.sub(r"\s", "", help_of(command, "--help-all"))


@pytest.mark.parametrize(
    ("command", "shown"),
    [
        ("wavesim image", "--patch-mm NUMBER Side of the object patch; default: the whole field. [mm]"),
        ("wavesim image", "--tilt-x-deg NUMBER Rotation of the lens about x. [deg; default: 0.0]"),
        ("wavesim resolve-lines", "[default: slices]"),
        ("lensdesign import", "--pixels INTEGER INTEGER Pixels of the sensor along x and y."),
        ("lensdesign ghost", "Wavelength in µm; default: the design's first wavelength."),
    ],
)
def test_units_and_defaults_are_shown(command: str, shown: str, help_of: Any) -> None:
    assert shown in " ".join(help_of(command, "--help-all").split())


def test_a_field_states_its_group_or_has_that_of_the_first_class_that_defines_it() -> None:
    def command(settings: CalibrationSettings) -> None: ...

    groups = {}
    for name, parameter in with_settings(command).__annotations__.items():
        groups[name] = parameter.__metadata__[0].rich_help_panel
    assert groups["patch_mm"] == OptionGroup.OBJECT
    assert groups["illumination"] == OptionGroup.ILLUMINATION
    assert groups["iterations"] == OptionGroup.SOLVER
    assert groups["engine"] == OptionGroup.ENGINE
    assert CalibrationSettings.model_fields["patch_mm"].json_schema_extra is None
    assert ReconstructionSettings.option_group == OptionGroup.SOLVER


@pytest.mark.parametrize(
    ("former", "present"),
    [
        ("wavesim choose", "choose-engine"),
        ("wavesim compare", "compare-engines"),
        ("wavesim resolve", "resolve-lines"),
        ("wavesim oracle", "check-engine"),
        ("tolerancing rare", "rare-failures"),
        ("tolerancing indices", "variance"),
    ],
)
def test_former_names_of_commands_work_and_are_not_listed(former: str, present: str, help_of: Any) -> None:
    package, name = former.split()
    shown = help_of(former, "-h").replace(f"{former} ", f"{package} {present} ")
    assert shown == help_of(f"{package} {present}", "-h")
    assert name not in APPS[package].commands
