"""Checkpoints: intermediate results of a run, stored in a file until the run is complete."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.array_files import read_arrays
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError

CHECKPOINT, EMPTY_CHECKPOINT, STOP_CHECKPOINT, SOURCE_CHECKPOINT, STOP_TRIALS = (
    "checkpoint.npz",
    "checkpoint_empty.npz",
    "checkpoint_stop.npz",
    "checkpoint_source.npz",
    "checkpoint_stop_trials.npz",
)
"""Names of the checkpoints of a run, of a search in frames without an object, of a search that follows a
change of the field stop, of the sources of light that were found, and of the field stops that were tried.
"""

CHECKPOINT_PREFIX = "checkpoint_search_"
"""Beginning of the names of the checkpoints of searches that follow each other."""

SEARCH_CHECKPOINTS = CHECKPOINT, EMPTY_CHECKPOINT, STOP_CHECKPOINT, SOURCE_CHECKPOINT, STOP_TRIALS
"""Names of all checkpoints of a calibration."""


@dataclass(frozen=True)
class Checkpoint:
    """File with the intermediate results of a run.

    Attributes
    ----------
    path : Path
        File (.npz).
    key : str
        Digest of inputs and settings; results under another key are not used.
    """

    path: Path
    key: str

    def load(self, copies: float = 0.0) -> dict[str, Any] | None:
        """Return the stored results; None if there are none, or they are of another run or damaged.

        They are also None if they need more memory than is free, in multiples of their size.
        """
        if not self.kept:
            return None
        try:
            # A checkpoint is not compressed, so that a damaged one cannot claim more memory than its own
            # size.
            return read_arrays(self.path, os.path.getsize(self.path), copies=copies)
        except (InputError, OSError):
            return None

    @property
    def kept(self) -> bool:
        """True if results of this run are stored; their arrays are not read."""
        try:
            return str(read_arrays(self.path, most_bytes=100_000, only=("key",))["key"]) == self.key
        except (InputError, KeyError):
            return False

    def keep(self, **data: Any) -> None:
        """Store results in place of the previous ones.

        Raises
        ------
        InputError
            If the file cannot be written, such as on a full disk; the previous results stay.
        """
        with atomic_path(self.path) as temporary:
            np.savez(temporary, key=np.asarray(self.key), **data)

    def drop(self) -> None:
        """Remove the stored results."""
        self.path.unlink(missing_ok=True)


class CheckpointSeries:
    """Checkpoints of searches that follow each other in a run: a finished search is not repeated.

    Parameters
    ----------
    folder
        Folder of the files; None: nothing is stored.
    key
        Digest of inputs and settings of the run.
    """

    def __init__(self, folder: Path | None, key: str) -> None:
        self._folder, self._key, self._count = folder, key, 0

    def next(self) -> Checkpoint | None:
        """Return the checkpoint of the next search of the run."""
        self._count += 1
        if self._folder is None:
            return None
        return Checkpoint(self._folder / f"{CHECKPOINT_PREFIX}{self._count}.npz", self._key)


def series_in(folder: Path) -> list[Path]:
    """Return the files of a series."""
    return sorted(folder.glob(f"{CHECKPOINT_PREFIX}*.npz"))


def drop_series(folder: Path) -> None:
    """Remove the files of a series, which a run needs no more."""
    for path in series_in(folder):
        path.unlink(missing_ok=True)


def key_of(*parts: bytes | str) -> str:
    """Return a digest of inputs and settings."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def digest_of(values: Any) -> str:
    """Return a digest of an array's values, without a copy if they are contiguous."""
    data: Any = np.ascontiguousarray(values)
    return hashlib.sha256(data).hexdigest()
