"""Results as notebooks show them."""

from __future__ import annotations

from lensdesign.common.notebook import html_table


def test_what_a_file_says_is_shown_and_not_obeyed() -> None:
    shown = html_table("<b>lens</b>", [("spread & limit", "1 < 2"), ("title", "\x1b")], "<svg></svg>")
    assert "<caption>&lt;b&gt;lens&lt;/b&gt;</caption>" in shown
    assert "spread &amp; limit" in shown
    assert "1 &lt; 2" in shown
    assert "\x1b" not in shown
    assert shown.endswith("</table><svg></svg>")
    assert "caption" not in html_table("", [])
