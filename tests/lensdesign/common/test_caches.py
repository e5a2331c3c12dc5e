"""The cache folder of the user."""

from __future__ import annotations

from pathlib import Path

import pytest

from lensdesign.common import caches


@pytest.mark.parametrize(
    ("platform", "stated", "expected"),
    [
        ("linux", "/var/own", "/var/own/transferlens"),
        ("linux", "relative", "/home/me/.cache/transferlens"),
        ("linux", "", "/home/me/.cache/transferlens"),
        ("darwin", "", "/home/me/Library/Caches/transferlens"),
        ("darwin", "/var/own", "/var/own/transferlens"),
    ],
)
def test_platforms_have_conventions(
    platform: str, stated: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(caches.sys, "platform", platform)
    monkeypatch.setenv("HOME", "/home/me")
    monkeypatch.setenv("XDG_CACHE_HOME", stated)
    assert caches.user_cache_folder() == Path(expected)
