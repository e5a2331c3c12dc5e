"""The start of a command with too little memory."""

from __future__ import annotations

import resource
import subprocess
import sys

import pytest


@pytest.mark.parametrize("program", ["lensdesign", "wavesim", "tolerancing"])
@pytest.mark.parametrize("kind", [resource.RLIMIT_AS, resource.RLIMIT_DATA])
def test_too_little_address_space_is_one_message(program: str, kind: int) -> None:
    done = subprocess.run(
        [sys.executable, "-m", f"{program}.cli", "--help"],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(kind, (600_000_000, 600_000_000)),
    )
    assert (done.returncode, done.stdout, len(done.stderr.splitlines())) == (2, "", 1)
    assert "0.60 GB" in done.stderr
    assert "0.7 GB" in done.stderr
