"""Both ways of reconstruction such that a run which was cut off goes on.

The object-domain way keeps all that its next iteration needs. Appendix A goes in parts, which are the same
whether a run is cut off or not, and each of which starts from the result of the one before: the feedback of
A5 starts anew with each part.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lensdesign.errors import atomic_path
from wavesim.engine import Engine
from wavesim.fields import Field
from wavesim.free_space import propagate
from wavesim.reconstruction import Progressed, Reconstructed, reconstruct
from wavesim.retrieval import (
    LIT,
    Array,
    Recorded,
    Retrieved,
    Start,
    residual,
    retrieve,
    stagnation,
)

KEEP_SECONDS = 20.0
"""Between two iterations of the object-domain reconstruction that are kept."""

PART_ITERATIONS = 100
"""Of Appendix A, in a part. Shorter ones would give up too much of the feedback."""

MEDIAN = 64.0
"""Of lit amplitudes, to which recorded ones are scaled for the total-variation step of Appendix A."""

DARKEST = 0.5
"""Standard deviations below which no amplitude goes into Appendix A. The total-variation step divides by the
modulus, and pixels that noise has made 0 would destroy their neighbours."""

Progress = Callable[[int, float], None]


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
        try:
            with np.load(self.path, allow_pickle=False) as kept:
                data = {name: kept[name] for name in kept.files}
        except Exception:  # of a damaged file, errors of many kinds
            return None
        return data if str(data.get("key")) == self.key else None

    def keep(self, **data: Any) -> None:
        """Replace what was kept."""
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


def reconstruct_resumably(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    checkpoint: Checkpoint | None = None,
    *,
    scale: float | None = None,
    **settings: Any,
) -> Reconstructed:
    """:func:`wavesim.reconstruct`; cut off, the next run goes on as if this one had not been.

    Parameters
    ----------
    engine, illumination, recorded, scale, **settings
        As of :func:`wavesim.reconstruct`.
    checkpoint
        Where the last iteration is kept, no more often than every `KEEP_SECONDS`.
    """
    kept = checkpoint.load() if checkpoint else None
    resume = None
    if kept is not None:
        resume = Progressed(
            kept["transmission"],
            kept["ahead"],
            float(kept["momentum"]),
            tuple(kept["misfit"].tolist()),
            float(kept["scale"]),
            int(kept["stage"]),
            int(kept["began"]),
        )
    last = time.monotonic()

    def keep(state: Progressed) -> None:
        nonlocal last
        if checkpoint is not None and time.monotonic() - last >= KEEP_SECONDS:
            checkpoint.keep(**vars(state))
            last = time.monotonic()

    return reconstruct(engine, illumination, recorded, scale=scale, resume=resume, keep=keep, **settings)


def retrieve_in_parts(
    engine: Engine,
    illumination: Field,
    recorded: Sequence[Recorded],
    checkpoint: Checkpoint | None = None,
    *,
    iterations: int = 500,
    start: str = "model",
    progress: Progress | None = None,
) -> tuple[Retrieved, tuple[Array, ...]]:
    """The paper's phase retrieval on the engine's exit grid, in parts of `PART_ITERATIONS`.

    Parameters
    ----------
    engine, illumination, recorded
        As of :func:`wavesim.reconstruct`.
    checkpoint
        Where finished parts are kept.
    iterations
        In all.
    start
        "model": the field of the illumination without object; "uniform" or "random", as of
        :func:`wavesim.retrieve`.
    progress
        Called after every iteration with its number and correlation.

    Returns
    -------
    Retrieved
        With the field in the recorded units.
    residual_maps : tuple of ndarray
        As of :func:`wavesim.reconstruct`.
    """
    planes, factor = _prepared(recorded)
    grid, wavelength = engine.scene.exit_grid, illumination.wavelength_um
    correlation: tuple[float, ...] = ()
    curve: tuple[float, ...] = ()
    kept = checkpoint.load() if checkpoint else None
    now: Start = "uniform" if start == "uniform" else "random"
    if kept is not None:
        now = Field(grid, kept["values"], wavelength)
        correlation, curve = tuple(kept["correlation"].tolist()), tuple(kept["curve"].tolist())
    elif start == "model":
        model = engine.forward(illumination)
        now = Field(grid, model.values * factor, wavelength)
    while True:
        done = len(correlation)
        found = retrieve(
            grid,
            wavelength,
            planes,
            now,
            iterations=min(PART_ITERATIONS, iterations - done),
            progress=_shifted(progress, done),
        )
        now = found.field
        correlation, curve = correlation + found.correlation, curve + found.residual_curve
        if len(correlation) >= iterations:
            break
        if checkpoint:
            checkpoint.keep(values=now.values, correlation=correlation, curve=curve)
    field = Field(grid, now.values / factor, wavelength)
    whole = replace(
        found,
        field=field,
        correlation=correlation,
        residual_curve=curve,
        stagnated_at=stagnation(correlation),
    )
    maps = tuple(
        np.abs(propagate(field, plane.distance_mm, check=False).values) - plane.amplitude
        for plane in recorded
    )
    return replace(whole, residuals=tuple(residual(field, plane) for plane in recorded)), maps


def _prepared(recorded: Sequence[Recorded]) -> tuple[list[Recorded], np.float32]:
    """Amplitudes for Appendix A, none of them darker than noise, and what they were multiplied by."""
    lifted = []
    for plane in recorded:
        least: Any = 0.0
        if plane.sigma is not None:
            least = DARKEST * np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
        lifted.append(np.maximum(plane.amplitude, least))
    lit = lifted[0] > LIT * lifted[0].max()
    factor = np.float32(MEDIAN / float(np.median(lifted[0][lit])))
    planes = [
        Recorded(
            plane.distance_mm,
            (factor * amplitude).astype(plane.amplitude.dtype),
            None if plane.sigma is None else factor * plane.sigma,
        )
        for plane, amplitude in zip(recorded, lifted, strict=True)
    ]
    return planes, factor


def _shifted(progress: Progress | None, done: int) -> Progress | None:
    return None if progress is None else lambda k, figure: progress(done + k, figure)
