"""Strip that names the active deviations of the lens, and resets them."""

from __future__ import annotations

from typing import Any

import param

from lensdesign.lens.lens import Lens
from studio.model.bench import Workbench
from studio.model.whatif import WhatIf
from studio.panes.common import HERE, ScriptPart, bench_of, follow


class DeviationStrip(ScriptPart):
    """Active deviations in words, and a button that resets them."""

    words = param.String(default="", doc="Active deviations; empty: the strip is hidden.")

    _esm = HERE / "strip.js"
    _stylesheets = [HERE / "strip.css"]  # noqa: RUF012 - as Panel has it


def deviations(lens: Workbench | Lens) -> DeviationStrip:
    """Return a strip with the active what-if, which is empty for a lens as designed."""
    bench = bench_of(lens)

    def on_message(message: dict[str, Any]) -> None:
        if message.get("action") == "reset":
            bench.set_what_if(WhatIf())

    strip = DeviationStrip(on_message, sizing_mode="stretch_width", margin=0)

    def update() -> None:
        words = ", ".join(bench.what_if.described(bench.lens))
        if strip.words != words:
            strip.words = words

    follow(bench, strip, update)
    return strip
