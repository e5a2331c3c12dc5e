"""Reconstructions whose object is not what is tested: it is the solver's first one, which is found sooner."""

from __future__ import annotations

from typing import Any

import pytest

from wavesim.reconstruction import frame_reconstruction, object_search
from wavesim.reconstruction.object_search import ObjectSearch


def search_plainly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let reconstructions of this process keep the first object, and find none from other starts.

    Its limit, edges and position are not improved, and no way out of a local minimum is sought. The verdict
    is still found with less of the total variation. All of these have tests of their own.
    """

    def as_found(_: ObjectSearch, found: Any, *__: Any) -> Any:
        return found

    for improvement in ("_with_own_limit", "_with_free_edges", "_placed"):
        monkeypatch.setattr(ObjectSearch, improvement, as_found)
    monkeypatch.setattr(object_search, "may_be_stagnated", lambda *_: False)
    monkeypatch.setattr(frame_reconstruction, "starts_needed", lambda case, settings, found: settings)
