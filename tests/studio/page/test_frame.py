"""Accessibility of the page, computed in a browser: names, roles, contrast and size of targets."""

from __future__ import annotations

from typing import Any

import pytest
from accessibility import faults
from served_workbench import Served, needs_browser, opened, until

from studio.panes.themes import COLORS, FIELDS, Theme

TASKS = ("Live", "Surfaces", "Optimize", "Explore", "Tolerances", "Compare", "Export", "Reconstructions")
BAD = """() => {
  const field = document.createElement("input");
  field.style.height = "30px";
  const words = document.createElement("p");
  words.textContent = "faint words";
  words.style.cssText = "color: #ccc; background: #fff";
  const tab = document.createElement("button");
  tab.textContent = "x";
  tab.style.cssText = "width: 12px; height: 12px; padding: 0";
  const parts = [field, words, tab];
  document.body.prepend(...parts);
  window.unmake = () => parts.forEach((part) => part.remove());
}"""


@needs_browser
def test_every_tab_can_be_used_by_everybody(served: Served, browser: Any) -> None:
    page = opened(browser, served)
    page.get_by_role("tab", name="What if", exact=True).click()
    amount = page.get_by_label("lens decenter y, mm", exact=True)
    amount.fill("0.03")
    amount.press("Enter")
    page.get_by_text("What if: decenter y 0.03 mm").wait_for()
    for theme, width in (("light", 1440), ("dark", 820)):
        page.set_viewport_size({"width": width, "height": 900})
        if page.evaluate("document.documentElement.dataset.theme") != theme:
            page.get_by_role("button", name="Dark or light").click()
        for tab in (*TASKS, "What if"):
            page.get_by_role("tab", name=tab, exact=True).click()
            page.get_by_role("tabpanel", name=tab, exact=True).wait_for()
            page.wait_for_timeout(200)
            found: list[str] = []

            def is_good() -> bool:
                found[:] = faults(page)  # noqa: B023 - called in this turn of the loop only
                return not found  # noqa: B023

            try:
                until(is_good, 120.0)  # A busy machine takes long, and dims what is not computed yet.
            except AssertionError:
                pytest.fail(f"{theme}, {width} pixels, {tab}: {found}")
    page.get_by_role("button", name="Load the deviations").click()
    page.get_by_role("dialog").wait_for()
    assert faults(page) == []
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Set all deviations to 0").first.click()
    page.evaluate(BAD)
    assert sorted(one.split(":")[0] for one in faults(page)) == [
        "contrast 1.61 of text",
        "no name",
        "target of 12 by 12 pixels",
    ]
    page.close()


@needs_browser
def test_tabs_are_changed_by_keys_and_dialogs_are_closed(served: Served, browser: Any) -> None:
    page = opened(browser, served)
    page.get_by_role("tab", name="Live").focus()
    page.keyboard.press("ArrowRight")
    page.get_by_role("tabpanel", name="Surfaces", exact=True).wait_for()
    assert page.get_by_role("tab", name="Surfaces").get_attribute("aria-selected") == "true"
    page.keyboard.press("End")
    page.get_by_role("tabpanel", name="Reconstructions", exact=True).wait_for()
    page.keyboard.press("ArrowRight")
    page.get_by_role("tabpanel", name="Live", exact=True).wait_for()
    page.get_by_role("button", name="Open another design").press("Enter")
    page.get_by_role("dialog", name="Open a design").wait_for()
    page.get_by_role("button", name="lens.toml").wait_for()
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="hidden")
    page.close()


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_texts_and_lines_of_charts_have_contrast(theme: Theme) -> None:
    """Charts are drawn on canvases, which the script cannot read."""
    colors = COLORS[theme]
    for name in ("ink", "faint"):
        assert contrast(colors[name], colors["paper"]) >= 4.5
    for color in (*FIELDS[theme], colors["accent"], colors["bad"], colors["near"]):
        assert contrast(color, colors["paper"]) >= 3.0


def contrast(one: str, other: str) -> float:
    low, high = sorted(luminance(color) for color in (one, other))
    return (high + 0.05) / (low + 0.05)


def luminance(color: str) -> float:
    parts = (int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    r, g, b = (v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in parts)
    return 0.2126 * r + 0.7152 * g + 0.0722 * b
