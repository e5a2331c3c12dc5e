"""Numbers in tables stay with their units, and pictures open at their full size."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.transforms import SphinxTransform

NO_BREAK = "\N{NO-BREAK SPACE}"
UNIT = re.compile(r"(?<=\d) (?=(?:%|×|[kMG]B|[mµn]m|ms|ns|s|min)(?!\w))")


class NumbersWithUnits(SphinxTransform):
    """Keep numbers in tables on one line with their units."""

    default_priority = 900

    def apply(self, **_: Any) -> None:
        for entry in self.document.findall(nodes.entry):
            for text in list(entry.findall(nodes.Text)):
                if not isinstance(text.parent, nodes.literal) and UNIT.search(text):
                    text.parent.replace(text, nodes.Text(UNIT.sub(NO_BREAK, text)))


class PictureWidths(SphinxTransform):
    """State the width of pictures, which Sphinx then links to the files: they open at their full size."""

    default_priority = 900

    def apply(self, **_: Any) -> None:
        from PIL import Image

        for image in self.document.findall(nodes.image):
            path = Path(self.env.srcdir, image["uri"])
            if "width" in image or not path.exists() or "cards" in _classes_around(image):
                continue
            if path.suffix == ".png":
                with Image.open(path) as picture:
                    image["width"] = f"{picture.width}px"
            elif path.suffix == ".svg":
                image["width"] = "100%"


def _classes_around(node: nodes.Node) -> set[str]:
    found: set[str] = set()
    while node is not None:
        found.update(node.get("classes", ()) if isinstance(node, nodes.Element) else ())
        node = node.parent
    return found


def setup(app: Any) -> dict[str, bool]:
    """Add the transforms."""
    app.add_transform(NumbersWithUnits)
    app.add_transform(PictureWidths)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
