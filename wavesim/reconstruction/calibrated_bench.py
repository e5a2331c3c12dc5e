"""A calibrated bench as a reconstruction uses it, with the object that its calibration has judged."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from lensdesign.common.array_files import read_arrays
from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.caches import has_user_code, user_code, user_key
from lensdesign.errors import InputError
from wavesim.metrics.goodness_of_fit import BenchUncertainty, GoodnessOfFit
from wavesim.reconstruction.found_object import FoundObject
from wavesim.runtime.checkpoint import digest_of, key_of
from wavesim.scene.settings import Kind
from wavesim.scene.system_state import SystemState
from wavesim.sensor.frames import Frame

JUDGED_OBJECT = "judged_object.npz"
"""Name of the file of the judged object, beside that of its calibration."""


@dataclass(frozen=True, eq=False)
class JudgedObject:
    """An object that was found and judged, for a later reconstruction with the same inputs.

    Attributes
    ----------
    key : str
        Digest of all inputs that decide the result (`FoundObject.key`).
    transmission : ndarray, shape (ny, nx)
        Complex transmission.
    residual_maps : tuple of ndarray
        For each plane, modelled less measured amplitude.
    curve : tuple of float
        Misfit of every iteration.
    of_method : mapping
        Results that only this method has, as JSON has them.
    verdict : GoodnessOfFit
        The verdict.
    """

    key: str
    transmission: NDArray[np.complexfloating]
    residual_maps: tuple[NDArray[Any], ...]
    curve: tuple[float, ...]
    of_method: Mapping[str, Any]
    verdict: GoodnessOfFit

    @classmethod
    def of(cls, found: FoundObject) -> JudgedObject:
        """Return what a later reconstruction needs of an object that is not refocused."""
        values = found.transmission.values
        return cls(found.key, values, found.residual_maps, found.curve, found.of_method, found.verdict)

    def write(self, path: Path) -> None:
        """Write the object to a file (.npz), with a code of the user.

        Raises
        ------
        InputError
            If the file cannot be written.
        """
        arrays: dict[str, Any] = {
            "key": self.key,
            "transmission": self.transmission,
            "curve": self.curve,
            "of_method": json.dumps(dict(self.of_method)),
            "verdict": json.dumps(_VERDICT.dump_python(self.verdict)),
        }
        arrays |= {f"residual_{index}": values for index, values in enumerate(self.residual_maps)}
        code = user_code(_content(arrays), user_key())
        with atomic_path(path) as temporary:
            np.savez(temporary, code=np.asarray(code), **arrays)


_VERDICT = TypeAdapter(GoodnessOfFit)


def _content(arrays: Mapping[str, Any]) -> bytes:
    """Return what the code of a file covers."""
    return key_of(*(part for name in sorted(arrays) for part in (name, digest_of(arrays[name])))).encode()


def read_judged_object(path: Path) -> JudgedObject | None:
    """Return the object of a file; None if there is none, if it is damaged, or if another user has made it.

    The object can be found again, so that a file that cannot be used does no harm.
    """
    try:
        stored = read_arrays(path, os.path.getsize(path), copies=0.0)
        code = str(stored.pop("code"))
        if not has_user_code(_content(stored), code, user_key()):
            return None
        names = (f"residual_{index}" for index in range(len(stored)))
        return JudgedObject(
            str(stored["key"]),
            stored["transmission"],
            tuple(stored[name] for name in names if name in stored),
            tuple(stored["curve"].tolist()),
            json.loads(str(stored["of_method"])),
            _VERDICT.validate_python(json.loads(str(stored["verdict"]))),
        )
    except (InputError, OSError, KeyError, ValueError, ValidationError):
        return None


def key_of_pictures(frames: Sequence[Frame]) -> str:
    """Return a digest of the counts of frames, whatever their order."""
    return key_of(*sorted(digest_of(frame.counts) for frame in frames))


@dataclass(frozen=True, eq=False)
class CalibratedBench:
    """A calibrated bench.

    Attributes
    ----------
    state : SystemState
        State of lens, light and camera.
    sought : frozenset of str
        Names of the parameters that the calibration has determined.
    frames_key : str
        Digest of the frames of the calibration (`key_of_pictures`). The verdict of a reconstruction of the
        same frames does not test these parameters again; other frames may show that the bench has changed.
    uncertainty : BenchUncertainty or None
        What the uncertainty of the bench leaves of an object; None if it is not known.
    judged : JudgedObject or None
        The object that the calibration has judged. A reconstruction with the same frames and settings
        returns it.
    """

    state: SystemState
    sought: frozenset[str] = frozenset()
    frames_key: str = ""
    uncertainty: BenchUncertainty | None = None
    judged: JudgedObject | None = None

    def sought_from(self, frames: Sequence[Frame]) -> frozenset[str]:
        """Return the names of the parameters that the calibration has determined from these frames."""
        return self.sought if self.sought and self.frames_key == key_of_pictures(frames) else frozenset()

    def uncertainty_for(self, kind: Kind) -> BenchUncertainty | None:
        """Return the uncertainty for a kind of object; None if the calibration was made with another kind."""
        if self.uncertainty is None:
            return None
        has_phase = bool(self.uncertainty.phase_waves)
        return self.uncertainty if has_phase == (kind != "amplitude") else None
