"""A calibrated bench as a reconstruction uses it, with the object that its calibration has judged."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from lensdesign.common.caches import has_user_code, user_code, user_key
from lensdesign.lens.poses import Pose
from wavesim.metrics.goodness_of_fit import BenchUncertainty, GoodnessOfFit
from wavesim.reconstruction.found_object import FoundObject
from wavesim.runtime.checkpoint import Checkpoint, digest_of, key_of
from wavesim.scene.settings import Kind
from wavesim.scene.system_state import SystemState, state_of

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
        Checkpoint(path, arrays.pop("key")).keep(code=np.asarray(code), **arrays)


_VERDICT = TypeAdapter(GoodnessOfFit)


def _content(arrays: Mapping[str, Any]) -> bytes:
    """Return what the code of a file covers."""
    parts = []
    for name in sorted(arrays):
        values = np.asarray(arrays[name])
        parts += [name, values.dtype.str, str(values.shape), digest_of(values)]
    return key_of(*parts).encode()


def read_judged_object(path: Path, key: str) -> JudgedObject | None:
    """Return the object of a file; None if it is not that of the inputs of a key.

    It is also None if there is no file, if it is damaged, or if another user has made it. The object can be
    found again, so that a file that cannot be used does no harm.
    """
    stored = Checkpoint(path, key).load(copies=1.0)
    if stored is None:
        return None
    try:
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
    except (KeyError, ValueError, ValidationError):
        return None


@dataclass(frozen=True, eq=False)
class CalibratedBench:
    """A calibrated bench.

    Attributes
    ----------
    state : SystemState
        State of lens, light and camera.
    sought : frozenset of str
        Names of the parameters that a calibration has sought until it converged.
    evidence_key : str
        Digest of its frames, light and kind of object (:func:`wavesim.reconstruction.problem.evidence_key`).
        The verdict of a reconstruction from the same evidence does not test these parameters again. Other
        frames may show that the bench has changed.
    uncertainty : BenchUncertainty or None
        What the uncertainty of the bench leaves of an object; None if it is not known.
    judged_with
        Function that returns the object that the calibration has judged with the inputs of a key
        (`FoundObject.key`), or None.
    """

    state: SystemState
    sought: frozenset[str] = frozenset()
    evidence_key: str = ""
    uncertainty: BenchUncertainty | None = None
    judged_with: Callable[[str], JudgedObject | None] = lambda key: None

    def uncertainty_for(self, kind: Kind) -> BenchUncertainty | None:
        """Return the uncertainty for a kind of object; None if the calibration was made with another kind."""
        if self.uncertainty is None:
            return None
        has_phase = bool(self.uncertainty.phase_waves)
        return self.uncertainty if has_phase == (kind != "amplitude") else None


def bench_of(calibration: CalibratedBench | SystemState | Pose | None) -> CalibratedBench | None:
    """Return the bench of a calibration, or of a state that is known otherwise; None for the design."""
    if calibration is None or isinstance(calibration, CalibratedBench):
        return calibration
    return CalibratedBench(state_of(calibration))
