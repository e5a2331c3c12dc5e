"""What all commands of wavesim print while they run."""

from __future__ import annotations

import pytest

from wavesim.cli.runs import progress


@pytest.mark.parametrize(
    ("resumes", "message", "end"),
    [(False, (), "from the beginning"), (False, ("kept",), "kept"), (True, (), "")],
)
def test_an_interrupt_of_a_run_without_checkpoints_says_that_it_is_lost(
    resumes: bool, message: tuple[str, ...], end: str
) -> None:
    with pytest.raises(KeyboardInterrupt) as stop, progress(resumes=resumes):
        raise KeyboardInterrupt(*message)
    assert " ".join(stop.value.args).endswith(end)
    assert bool(stop.value.args) == bool(end)
