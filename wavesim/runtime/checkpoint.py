"""What finished parts of a run gave, kept in a file until the run is done."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.common.array_files import read_arrays
from lensdesign.errors import InputError, atomic_path

CHECKPOINT, EMPTY_CHECKPOINT = "checkpoint.npz", "checkpoint_empty.npz"
"""Files in which a run keeps where it stands, and a search in frames without an object."""


KEY_BYTES = 100_000
"""Most bytes of the key of a checkpoint."""


@dataclass(frozen=True)
class Checkpoint:
    """Where a run keeps what its finished parts gave.

    Attributes
    ----------
    path : Path
        File (.npz).
    key : str
        Of inputs and settings; what was kept under another one is not used.
    """

    path: Path
    key: str

    def load(self) -> dict[str, Any] | None:
        """What was kept; None if nothing was, or it is of another run or damaged."""
        if not self.kept:
            return None
        try:
            # A checkpoint is not packed: whoever damages one cannot have it take more than its own size.
            return read_arrays(self.path, os.path.getsize(self.path), copies=0.0)
        except (InputError, OSError):
            return None

    @property
    def kept(self) -> bool:
        """Whether something of this run was kept; its arrays are not read."""
        try:
            return str(read_arrays(self.path, KEY_BYTES, only=("key",))["key"]) == self.key
        except (InputError, KeyError):
            return False

    def keep(self, **data: Any) -> None:
        """Replace what was kept.

        Raises
        ------
        InputError
            If the file cannot be written, as where the disk is full; what was kept before stays.
        """
        with atomic_path(self.path) as temporary:
            np.savez(temporary, key=np.asarray(self.key), **data)

    def drop(self) -> None:
        """Remove what was kept."""
        self.path.unlink(missing_ok=True)


def key_of(*parts: bytes | str) -> str:
    """A digest of inputs and settings."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big") + data)
    return digest.hexdigest()


def digest_of(values: Any) -> str:
    """Of an array's values, without a copy of them where they lie in one piece."""
    data: Any = np.ascontiguousarray(values)
    return hashlib.sha256(data).hexdigest()
