"""Limits that are found with few searches, for tests of what is made of them."""

from __future__ import annotations

import pytest

from lensdesign.optimization.limits import search


@pytest.fixture
def few_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search limits with fewer starts, fewer fractions and less precision.

    The tests of :mod:`lensdesign.optimization.limits.search` keep all of them.
    """
    monkeypatch.setattr(search, "FEWEST_STARTS", 3)
    monkeypatch.setattr(search, "FRACTIONS", (search.FRACTIONS[0], search.FRACTIONS[-1]))
    monkeypatch.setattr(search, "RESOLUTION", 2e-3)
