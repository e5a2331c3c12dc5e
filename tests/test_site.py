"""The documentation's site: it builds without a warning, needs no network, and its reference is whole."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import zlib
from pathlib import Path

import pytest
from faces import faces
from places import ROOT

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
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr, done.stderr
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

    page = (site / "commands.html").read_text(encoding="utf-8")
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
    page = (site / "theory.html").read_text(encoding="utf-8")
    fences = (ROOT / "docs" / "theory.md").read_text(encoding="utf-8").count("```math")
    assert fences > 5
    assert page.count('<svg role="img"') == fences
    assert "language-math" not in page


def test_code_breaks_between_words_and_numbers_keep_their_units(site: Path) -> None:
    page = (site / "accuracy.html").read_text(encoding="utf-8")
    words = (f'<span class="whole">{word}</span>' for word in ("python", "-m", "benchmarks.optimizer"))
    assert f"<code>{' '.join(words)}</code>" in page
    assert '<td><span class="whole">1e-14 mm</span></td>' in page
    assert '<span class="whole">1.9 ms</span>, time' in page


def test_lists_are_lists(site: Path) -> None:
    for page in site.glob("*.html"):
        paragraphs = re.findall(r"<p>.*?</p>", page.read_text(encoding="utf-8"), re.DOTALL)
        assert not [text for text in paragraphs if "\n- " in text], page


def test_pictures_open_at_their_full_size(site: Path) -> None:
    for name in ("engines", "theory", "gallery"):
        page = (site / f"{name}.html").read_text(encoding="utf-8")
        for picture in re.findall(r'<p>(?:<a href="([^"]+)">)?<img [^>]*src="(images/[^"]+)"', page):
            assert picture[0] == picture[1]
            assert (site / picture[1]).exists()


def documented(site: Path) -> set[str]:
    """Names in the site's inventory (Sphinx's format: four lines, then one line a name, compressed)."""
    data = (site / "objects.inv").read_bytes()
    for _ in range(4):
        data = data[data.index(b"\n") + 1 :]
    return {line.split(" ")[0] for line in zlib.decompress(data).decode().splitlines()}
