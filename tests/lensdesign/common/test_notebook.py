"""Results as notebooks show them."""

from __future__ import annotations

import base64
import io
import re

import numpy as np
from PIL import Image

from lensdesign.common.notebook import MOST_PIXELS, html_picture, html_table


def test_what_a_file_says_is_shown_and_not_obeyed() -> None:
    shown = html_table("<b>lens</b>", [("spread & limit", "1 < 2"), ("title", "\x1b")], "<svg></svg>")
    assert "<caption>&lt;b&gt;lens&lt;/b&gt;</caption>" in shown
    assert "spread &amp; limit" in shown
    assert "1 &lt; 2" in shown
    assert "\x1b" not in shown
    assert shown.endswith("</table><svg></svg>")
    assert "caption" not in html_table("", [])


def test_a_picture_is_small_grey_and_has_its_first_row_below() -> None:
    values = np.zeros((3 * MOST_PIXELS, 10), complex)
    values[: 2 * MOST_PIXELS] = 2j
    found = re.fullmatch(r'<img src="data:image/png;base64,([^"]*)">', html_picture(values))
    assert found is not None
    shown = np.asarray(Image.open(io.BytesIO(base64.b64decode(found[1]))))
    assert shown.shape == (MOST_PIXELS, 4)
    assert shown[0].tolist() == [0] * 4
    assert shown[-1].tolist() == [255] * 4
    assert "data:image/png" in html_picture(np.zeros((2, 2)))
