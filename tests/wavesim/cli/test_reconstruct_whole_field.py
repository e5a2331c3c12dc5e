"""What `wavesim reconstruct` has for whole fields, on a small twin: a limit of memory, progress."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import Command
from wavesim_command import ENDED, written

from wavesim.cli import runs
from wavesim.reconstruction import problem
from wavesim.runtime.memory import MemoryNeed
from wavesim.runtime.scratch import Scratch


@pytest.mark.usefixtures("quick_verdicts")
def test_a_limit_of_memory_is_told_kept_by_files_and_refused_where_too_low(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, data: Path
) -> None:
    needs: list[MemoryNeed] = []
    files: set[str] = set()
    predict, make = problem.run_bytes, Scratch._mapped

    def predicted(*arguments: Any, **settings: Any) -> MemoryNeed:
        needs.append(predict(*arguments, **settings))
        return needs[-1]

    def made(self: Scratch, size: int, what: str) -> Any:
        files.add(what)
        return make(self, size, what)

    monkeypatch.setattr(problem, "run_bytes", predicted)
    monkeypatch.setattr(Scratch, "_mapped", made)
    options = ("--engine", "eikonal", "--kind", "amplitude", "--iterations", 3, "--truth", data)
    code, out, err = run(*options, "--json", "-o", tmp_path / "free")
    assert code in ENDED, err
    assert files == set()
    assert "memory:" not in err
    free, whole = written(tmp_path / "free")
    need = needs[0]
    assert json.loads(out)["memory"]["predicted_bytes"] == need.most_bytes
    limit_gb = 1e-9 * need.least_bytes + 1e-6
    code, _, err = run(*options, "--memory-gb", limit_gb, "-o", tmp_path / "bound")
    assert code in ENDED, err
    assert f" GB of {limit_gb:.3g} GB allowed" in err
    assert files == {
        "the illumination",
        "the recorded amplitudes",
        "the standard deviations",
        "the true object",
        "a step",
        "a field within the lens's band",
    }
    bound, same = written(tmp_path / "bound")
    np.testing.assert_allclose(same["values"], whole["values"], atol=1e-6)
    assert bound["truth"] == pytest.approx(free["truth"], rel=1e-4)
    assert not [path for path in (tmp_path / "bound").iterdir() if path.name.startswith(".")]
    for limit, message in (
        (0.3, "needs at least 0.4"),
        (-1, "--memory-gb = -1"),
        ("nan", "--memory-gb = nan"),
    ):
        code, out, err = run(*options, "--memory-gb", limit, "-o", tmp_path / "low")
        assert (code, out) == (2, "")
        assert message in err
        assert not (tmp_path / "low").exists()
    code, _, err = run(*options, "--memory-gb", 0.3, "--refocus-mm=-0.01,0.01", "-o", tmp_path / "low")
    assert code == 2
    assert "or refocus a part of the object alone (--region-mm)" in err


class Count:
    """In place of the progress: what it would show."""

    def __init__(self) -> None:
        self.shown: list[str] = []

    def update(self, _done: int, _total: int | None, what: str) -> None:
        self.shown.append(what)


def test_progress_is_told_within_an_iteration(
    run: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count, engines = Count(), []

    @contextmanager
    def shown(_what: str) -> Iterator[Count]:
        yield count

    make = problem.imaging_engine

    def kept(*arguments: Any, **settings: Any) -> Any:
        engines.append(make(*arguments, **settings))
        return engines[-1]

    monkeypatch.setattr(runs, "progress_count", shown)
    monkeypatch.setattr(problem, "imaging_engine", kept)
    options = ("--engine", "hierarchical", "--kind", "amplitude", "--iterations", 2)
    code, _, err = run(*options, "-o", tmp_path)
    assert code in ENDED, err
    (engine,) = engines
    groups = len(engine.groups)
    assert count.shown[0] == "object: engine hierarchical"
    assert f"object: engine hierarchical, super-tile {groups} of {groups}" in count.shown
    assert any(re.fullmatch(rf"object: misfit 0\.\d{{5}}, super-tile 1 of {groups}", s) for s in count.shown)
    assert engine.progress is None
