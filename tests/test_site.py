"""The documentation's site: it builds without a warning, needs no network, and its reference is whole.

Tests of what a browser shows are skipped without Chromium.
"""

from __future__ import annotations

import importlib
import re
import shutil
import subprocess
import sys
import zlib
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from accessibility import faults
from faces import faces
from places import ROOT

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium found on this machine")
PACKAGES = ("lensdesign", "wavesim", "tolerancing", "studio")
# What a browser loads by itself: not links that a reader may follow.
LOADED = re.compile(
    r"<(?:script|img|iframe|source|video|audio)\b[^>]*\bsrc=\"(?:https?:)?//|"
    r"<link\b(?![^>]*rel=\"(?:canonical|prev|next)\")[^>]*\bhref=\"(?:https?:)?//"
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site as `make docs` builds it."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "--fail-on-warning", "--quiet", "--conf-dir", "docs"]
    command += ["--doctree-dir", str(tmp_path_factory.mktemp("doctrees")), ".", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_in_the_reference(site: Path, package: str) -> None:
    shown = documented(site)
    for face in faces(package):
        for name in face.__all__:
            public = getattr(face, name)
            if hasattr(public, "__qualname__"):  # a table stands with the module that has it
                assert f"{public.__module__}.{public.__qualname__}" in shown, f"{face.__name__}.{name}"


@pytest.mark.parametrize("package", ["lensdesign", "wavesim", "tolerancing"])
def test_every_command_is_on_its_page(site: Path, package: str) -> None:
    import typer

    page = (site / "docs" / "commands.html").read_text(encoding="utf-8")
    group = typer.main.get_command(importlib.import_module(f"{package}.cli.commands").app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        assert f'id="{package}-{name}"' in page
        for parameter in command.params:  # former names of options are not shown
            for option in [text for text in parameter.opts if text.startswith("--")][:1]:
                assert option in page, f"{package} {name} {option}"


def test_nothing_is_loaded_from_other_hosts(site: Path) -> None:
    for page in site.rglob("*.html"):
        assert not LOADED.search(page.read_text(encoding="utf-8")), page
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        assert not re.search(r"(?:@import|url\()\s*[\"']?(?:https?:)?//", text), sheet


def test_equations_are_drawn(site: Path) -> None:
    page = (site / "docs" / "theory.html").read_text(encoding="utf-8")
    fences = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8").count("```math")
    assert fences > 5
    assert page.count('<svg role="img"') == fences
    assert "language-math" not in page


def test_code_breaks_between_words_and_numbers_keep_their_units(site: Path) -> None:
    page = (site / "docs" / "accuracy.html").read_text(encoding="utf-8")
    words = (f'<span class="pre">{word}</span>' for word in ("python", "-m", "benchmarks.optimizer"))
    assert " ".join(words) in page
    assert "<p>1e-14\N{NO-BREAK SPACE}mm</p>" in page
    assert "1.9\N{NO-BREAK SPACE}ms, time" in page


def test_lists_are_lists(site: Path) -> None:
    for page in site.glob("docs/*.html"):
        paragraphs = re.findall(r"<p>.*?</p>", page.read_text(encoding="utf-8"), re.DOTALL)
        assert not [text for text in paragraphs if "\n- " in text], page


def test_pictures_open_at_their_full_size(site: Path) -> None:
    for name in ("engines", "theory", "gallery"):
        page = (site / "docs" / f"{name}.html").read_text(encoding="utf-8")
        pictures = re.findall(r'<a [^>]*href="([^"]+)"><img [^>]*src="\.\./(_images/[^"]+)" style', page)
        assert len(pictures) >= 4, name
        for link, picture in pictures:
            assert link == f"../{picture}"
            assert (site / picture).exists()


def test_sections_are_apart_and_the_version_is_shown(site: Path) -> None:
    page = (site / "docs" / "index.html").read_text(encoding="utf-8")
    sections = (
        "Tutorial",
        "Gallery",
        "Workbench",
        "How-to",
        "Explanation",
        "Reference",
        "Results",
        "Project",
    )
    header = page[page.index("navbar-nav") : page.index("bd-main")]
    found = re.findall(r'class="nav-link nav-internal"[^>]*>\s*(\S+)\s*<', header)
    assert tuple(dict.fromkeys(found)) == sections
    assert f"transferlens {version('transferlens')}" in page
    assert (site / "CHANGELOG.html").exists()
    assert 'url=docs/index.html"' in (site / "index.html").read_text(encoding="utf-8")


def test_names_and_commands_in_the_text_are_links(site: Path) -> None:
    page = (site / "docs" / "theory.html").read_text(encoding="utf-8")
    assert 'href="reference/pupils.html#wavesim.pupil.characteristic.PupilSampler"' in page
    assert 'href="commands.html#lensdesign-check"' in page


def test_long_pages_have_pictures() -> None:
    for path in (ROOT / "docs").glob("*.md"):
        text = path.read_text(encoding="utf-8")
        if len(text.split()) > 1000 and path.stem != "security":
            assert "](images/" in text, path


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A browser without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM)
        yield browser
        browser.close()


@needs_browser
def test_no_page_scrolls_sideways_on_a_telephone(site: Path, browser: Any) -> None:
    # Scripts, which take most of the time, change nothing of the layout.
    page = browser.new_page(viewport={"width": 390, "height": 800}, java_script_enabled=False)
    paths = [
        path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts and path.parent != site
    ]
    assert len(paths) > 40
    for path in paths:
        page.goto(path.as_uri(), wait_until="load")
        assert page.evaluate("document.scrollingElement.scrollWidth") <= 390, path


@needs_browser
@pytest.mark.parametrize("theme", ["light", "dark"])
def test_pages_can_be_used_by_everybody(site: Path, browser: Any, theme: str) -> None:
    page = browser.new_page(viewport={"width": 1200, "height": 900}, color_scheme=theme)
    for name in ("index.html", "docs/tutorial.html", "docs/reference/lenses.html"):
        page.goto((site / name).as_uri(), wait_until="load")
        page.locator("main").first.wait_for()
        page.wait_for_function("document.body && document.documentElement.dataset.theme")
        assert faults(page) == [], name
    page.close()


@needs_browser
def test_search_works_on_pages_opened_as_files_and_loads_nothing_from_other_hosts(
    site: Path, browser: Any
) -> None:
    page, loaded, errors = browser.new_page(), [], []
    page.on("request", lambda request: loaded.append(request.url))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((site / "docs" / "index.html").as_uri())
    page.goto((site / "search.html").as_uri() + "?q=%C3%A9tendue")
    page.wait_for_selector("#search-results li a[href*='theory.html']")
    assert errors == []
    assert len(loaded) > 10
    assert all(url.startswith(("file:", "data:")) for url in loaded)


def documented(site: Path) -> set[str]:
    """Names in the site's inventory (Sphinx's format: four lines, then one line a name, compressed)."""
    data = (site / "objects.inv").read_bytes()
    for _ in range(4):
        data = data[data.index(b"\n") + 1 :]
    return {line.split(" ")[0] for line in zlib.decompress(data).decode().splitlines()}
