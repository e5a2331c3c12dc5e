"""How the packages are built: folders and their order, no import cycles, tests beside their modules."""

from __future__ import annotations

import ast
import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from places import ROOT

PACKAGES = ("lensdesign", "wavesim", "tolerancing", "studio")

# A folder imports only what stands before it; folders on one line import nothing from each other.
ORDER = {
    "lensdesign": (
        "errors",
        "common",
        "lens",
        "files",
        "raytrace",
        "analysis",
        "optimization",
        "stock",
        "manufacture",
        "plots",
        "exploration",
        "cli",
    ),
    "wavesim": (
        "runtime",
        "fields",
        "scene",
        "targets rays analytic",
        "pupil",
        "engines",
        "sensor metrics",
        "plots",
        "forward",
        "reconstruction",
        "calibration",
        "cli",
    ),
    "tolerancing": (
        "perturbations",
        "merits",
        "study",
        "store cost",
        "statistics",
        "prediction",
        "budgets",
        "report run",
        "cli",
    ),
    "studio": ("model", "panes", "page"),
}
LEVEL = {
    f"{package}.{folder}": level
    for package, levels in ORDER.items()
    for level, folders in enumerate(levels)
    for folder in folders.split()
}
# Tests of how the parts behave together, and of what is done to all of them.
ELSEWHERE = ("attack", "support")


@cache
def modules() -> dict[str, Path]:
    """Every module by its name; a package goes by its folder's."""
    found = {}
    for path in sorted(p for package in PACKAGES for p in (ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


@cache
def imports() -> dict[str, set[str]]:
    """What each module imports, anywhere in it: at its head, in functions, for types alone."""
    return {name: _imported(name, path) - {name} for name, path in modules().items()}


def _imported(name: str, path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in modules()}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{name}: imports are absolute"
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found |= {inner if inner in modules() else str(node.module)} & modules().keys()
    return found


def folder_of(module: str) -> str:
    return ".".join(module.split(".")[:2])


def test_folders_are_those_of_the_order() -> None:
    folders = {folder_of(name) for name in modules() if "." in name} - {f"{p}.__main__" for p in PACKAGES}
    assert folders == set(LEVEL)


def test_packages_and_folders_import_only_what_stands_before_them() -> None:
    wrong = []
    for name, others in imports().items():
        package = name.split(".")[0]
        for other in others:
            theirs, (here, there) = other.split(".")[0], (folder_of(name), folder_of(other))
            if theirs != package:
                upward = PACKAGES.index(theirs) > PACKAGES.index(package)
            else:
                upward = here != there and LEVEL.get(there, -1) >= LEVEL.get(here, len(LEVEL))
            if upward:
                wrong.append(f"{name} imports {other}")
    assert wrong == []


def import_cycle() -> list[str]:
    """Return the modules of one import cycle in order; empty if there is none."""
    try:
        TopologicalSorter(imports()).prepare()
    except CycleError as found:
        return list(reversed(found.args[1]))
    return []


def test_no_import_goes_in_a_circle() -> None:
    assert import_cycle() == []


def test_no_module_takes_the_name_of_what_its_folder_hands_on() -> None:
    """Importing the module would put it in the place of the function."""
    for name, path in modules().items():
        face = path.with_suffix(".pyi")
        if path.name != "__init__.py" or not face.exists():
            continue
        handed = {
            alias.asname or alias.name
            for node in ast.walk(ast.parse(face.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        own = {p.stem if p.is_file() else p.name for p in path.parent.iterdir()}
        assert handed & own == set(), name


def test_tests_stand_where_their_modules_do() -> None:
    """`test_x.py`, or `test_x_of_something.py`, tests the module x of the folder of the same name."""
    tests = ROOT / "tests"
    for path in tests.rglob("test_*.py"):
        folder = path.parent.relative_to(tests)
        if folder == Path() or folder.parts[0] in ELSEWHERE:
            continue
        words = path.stem.removeprefix("test_").split("_")
        named = ["_".join(words[:count]) for count in range(1, len(words) + 1)]
        assert any((ROOT / folder / f"{name}.py").exists() for name in named), path.relative_to(ROOT)


def test_the_map_names_the_folders_that_exist() -> None:
    """Each folder on the map of CONTRIBUTING.md exists, and each package folder is on it."""
    block = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## Map")[2].partition("##")[0]
    named: set[Path] = set()
    package = ROOT
    for line in (line for line in block.splitlines() if line.startswith("    ")):
        names = re.findall(r"(?:(?<=\s)|^)([a-z_]+)/(?=[\s,;)]|$)", line)
        if not line.startswith("     "):
            package = ROOT / names.pop(0)
            named.add(package)
        own: list[Path] = []
        for name in names:
            options = [*(folder / name for folder in own), package / name]
            place = next((one for one in options if one.is_dir()), options[-1])
            own += [place] if place.parent == package else []
            named.add(place)
    missing = sorted(str(path.relative_to(ROOT)) for path in named if not path.is_dir())
    assert missing == []
    packages = {path.parent for path in modules().values() if path.name == "__init__.py"}
    absent = sorted(str(path.relative_to(ROOT)) for path in packages - named)
    assert absent == []
