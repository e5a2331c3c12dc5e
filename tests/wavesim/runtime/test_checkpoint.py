"""What is kept of a run that may be cut off."""

from pathlib import Path

import numpy as np

from wavesim.runtime.checkpoint import Checkpoint, key_of


def test_what_was_kept_of_another_run_is_not_used(tmp_path: Path) -> None:
    kept = Checkpoint(tmp_path / "checkpoint.npz", key_of("a", b"b"))
    kept.keep(values=np.ones(3))
    found = kept.load()
    assert found is not None
    assert found["values"].tolist() == [1.0, 1.0, 1.0]
    assert Checkpoint(kept.path, key_of("ab", b"")).load() is None
    kept.path.write_bytes(b"damaged")
    assert kept.load() is None
