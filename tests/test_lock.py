"""The lock file: every version with the hashes of its files, and no place to fetch them from."""

import re

from places import ROOT

VERSION = re.compile(r"[\w.\[\]-]+==[\w.]+( ; .+)? \\")
HASH = re.compile(r"    --hash=sha256:[0-9a-f]{64}( \\)?")


def test_every_version_has_hashes_and_names_no_host():
    lines = [
        line for line in (ROOT / "requirements.lock").read_text().splitlines() if not line.startswith("#")
    ]
    assert sum(1 for line in lines if VERSION.fullmatch(line)) > 100
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        assert VERSION.fullmatch(line) or HASH.fullmatch(line), line
        assert line.endswith("\\") == bool(HASH.fullmatch(following)), line
