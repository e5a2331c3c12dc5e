"""What all commands of wavesim print while they run."""

from __future__ import annotations

from pathlib import Path

import pytest

from wavesim.cli.runs import Run


@pytest.mark.parametrize(
    ("resumes", "has_folder", "message", "end"),
    [
        (False, False, (), "from the beginning"),
        (False, False, ("kept",), "kept"),
        (True, False, (), ""),
        (True, True, (), "from the beginning"),
    ],
)
def test_an_interrupt_of_a_run_without_checkpoints_says_that_it_is_lost(
    resumes: bool, has_folder: bool, message: tuple[str, ...], end: str, tmp_path: Path
) -> None:
    run = Run(as_json=False, resumes=resumes, folder=tmp_path if has_folder else None)
    with pytest.raises(KeyboardInterrupt) as stop, run.computing():
        raise KeyboardInterrupt(*message)
    assert " ".join(stop.value.args).endswith(end)
    assert bool(stop.value.args) == bool(end)
