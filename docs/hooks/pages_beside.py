"""Pages of the site that lie elsewhere in the repository, such as the changelog, and links to them."""

from __future__ import annotations

import base64
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

PAGES = {
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "LICENSE": "license.md",
    "README.md": "index.md",
    "benchmarks/README.md": "benchmarks.md",
}
LINK = re.compile(r"(\]\()(?![a-z]+:)([^)\s#]+)")


def on_files(files: Any, config: Any) -> Any:
    """Add the pages, and each notebook as a page with its figures."""
    root = Path(config.docs_dir).parent
    for path, uri in PAGES.items():
        if files.get_file_from_path(uri) is None:
            files.append(File.generated(config, uri, content=_text(root / path)))
    for notebook in sorted((root / "notebooks").glob("*.ipynb")):
        uri = f"notebooks/{notebook.stem}"
        text, figures = notebook_page(notebook)
        files.append(File.generated(config, f"{uri}.md", content=text))
        files.append(File.generated(config, f"{uri}.ipynb", abs_src_path=str(notebook)))
        for name, content in figures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Turn links that hold in the repository into links that hold on the site."""
    beside = {uri: path for path, uri in PAGES.items() if uri != "index.md"}
    uri = page.file.src_uri
    folder = posixpath.dirname(beside.get(uri, uri if uri.startswith("notebooks/") else f"docs/{uri}"))

    def moved(link: re.Match[str]) -> str:
        there = posixpath.normpath(posixpath.join(folder, link[2]))
        there = PAGES.get(there, there.removeprefix("docs/"))
        if there.startswith("notebooks/") and link[2].endswith(".ipynb") and not uri.startswith("notebooks/"):
            there = there.removesuffix(".ipynb") + ".md"
        return link[1] + posixpath.relpath(there, posixpath.dirname(uri) or ".")

    return LINK.sub(moved, markdown)


def notebook_page(notebook: Path) -> tuple[str, dict[str, bytes]]:
    """A notebook as Markdown, and its figures by file name."""
    import nbformat

    parts: list[str] = []
    figures: dict[str, bytes] = {}
    for cell in nbformat.read(notebook, as_version=4).cells:
        parts.append(cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```")
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{notebook.stem}_{len(figures) + 1}.png"
                figures[name] = base64.b64decode(data["image/png"])
                parts.append(f"![Figure of the cell above]({name})")
            else:
                said = output.get("text") or data.get("text/plain", "")
                parts.append(f"```text\n{said.rstrip()}\n```")
    parts.insert(1, f"This notebook as a file: [{notebook.name}]({notebook.name})")
    return "\n\n".join(parts), figures


def _text(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    return text if path.suffix == ".md" else f"# Licence\n\n{text}"
