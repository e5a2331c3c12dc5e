"""Where arrays lie and are worked on: this computer's memory, or that of a graphics processor (GPU).

Code for a device is written against its array module alone, so that the same lines run with NumPy and with
CuPy. Nonuniform Fourier transforms come from FINUFFT, from cuFINUFFT or, of several terms on a plane in
single precision, from :mod:`wavesim.runtime.fourier.terms`; all have the same methods.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError

DEVICES = ("cpu", "gpu")

HOST_BYTES = 1_000_000_000
"""That work may take where a device's memory is this computer's."""

WORTH_THREADS = 3
"""Of FINUFFT, that do no more than one of the transform of terms."""

NEEDED = ("cupy", "cufinufft")
INSTALL = "install transferlens with its extra gpu (pip install 'transferlens[gpu]')"


@dataclass(frozen=True)
class Precision:
    """How finely a part of a field is computed.

    Attributes
    ----------
    dtype : numpy dtype
        complex64 or complex128.
    transform_error : float
        Of the nonuniform Fourier transform.
    interpolation_error : float
        Of the interpolation from a coarse grid.
    """

    dtype: np.dtype[Any]
    transform_error: float
    interpolation_error: float


MakePlan = Callable[[int, tuple[int, ...], Precision], Any]
"""Makes a nonuniform Fourier transform of type 2 or 1; shape (transforms, modes along y, modes along x)."""


@dataclass(frozen=True, eq=False)
class Device:
    """An array module, and what it needs beside.

    Attributes
    ----------
    name : str
        One of `DEVICES`.
    xp : module
        NumPy or CuPy.
    plan : callable
        Makes a nonuniform Fourier transform; points are given to it by `setpts`.
    memory : callable
        Gives the free bytes and all bytes of the device's memory.
    """

    name: str
    xp: Any
    plan: MakePlan
    memory: Callable[[], tuple[int, int]]

    def to_device(self, values: Any, dtype: Any = None) -> Any:
        """An array of the device, C-contiguous; not copied where it is one already."""
        return self.xp.ascontiguousarray(self.xp.asarray(values, dtype=dtype))

    def to_host(self, values: Any) -> NDArray[Any]:
        """An array of this computer's memory."""
        return np.asarray(values.get() if hasattr(values, "get") else values)

    @property
    def memory_bytes(self) -> int:
        """That one step of work may take: half of what is free."""
        return self.memory()[0] // 2


def device_named(name: str) -> Device:
    """A device that is there and works.

    Parameters
    ----------
    name
        "cpu": NumPy and this computer's memory. "gpu": CuPy and cuFINUFFT.

    Raises
    ------
    InputError
        If there is no device of this name, its packages are not installed, or no GPU answers.
    """
    if name == "cpu":
        return Device("cpu", np, plan_of_terms, lambda: (HOST_BYTES, HOST_BYTES))
    if name != "gpu":
        raise InputError(
            f"device = {name!r}: there is no such device; allowed: {', '.join(DEVICES)}"
            f"{did_you_mean(name, DEVICES)}"
        )
    cupy, cufinufft = (_module(module) for module in NEEDED)
    try:
        count = int(cupy.cuda.runtime.getDeviceCount())
    except cupy.cuda.runtime.CUDARuntimeError as error:
        raise InputError(f"device = 'gpu': no GPU answers: {error}") from error
    if count < 1:
        raise InputError("device = 'gpu': this computer has no GPU that CUDA knows of")

    def plan(kind: int, shape: tuple[int, ...], precision: Precision) -> Any:
        return cufinufft.Plan(*_described(kind, shape, precision), dtype=precision.dtype.name)

    return Device("gpu", cupy, plan, lambda: _gpu_memory(cupy))


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(f"device = 'gpu': {name} cannot be imported ({error}); {INSTALL}") from error


def _gpu_memory(cupy: Any) -> tuple[int, int]:
    """Free bytes, those that CuPy keeps for its next arrays included, and all."""
    free, total = cupy.cuda.runtime.memGetInfo()
    return int(free) + int(cupy.get_default_memory_pool().free_bytes()), int(total)


def plan_of_terms(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """The quickest transform in so many threads, as :func:`fourier_plan`."""
    if precision.dtype != np.complex64 or len(shape) != 3 or threads > WORTH_THREADS:
        return fourier_plan(kind, shape, precision, threads)
    from wavesim.runtime.fourier.terms import TermsTransform

    return TermsTransform(kind, shape, precision.transform_error)


def fourier_plan(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """A nonuniform transform of FINUFFT of type 2, or of type 1, its conjugate transpose.

    Parameters
    ----------
    kind
        2 or 1.
    shape
        Number of transforms, then of modes along each axis.
    precision
        How finely.
    threads
        Number of threads.
    """
    import finufft  # type: ignore[import-untyped]

    return finufft.Plan(
        *_described(kind, shape, precision),
        dtype=precision.dtype.name,
        nthreads=threads,
        upsampfac=1.25 if precision.transform_error > 9e-5 else 2.0,
        showwarn=0,
    )


def _described(kind: int, shape: tuple[int, ...], precision: Precision) -> tuple[Any, ...]:
    """Type, modes, number of transforms, error and sign, as both libraries take them."""
    return kind, shape[1:], shape[0], precision.transform_error, -1 if kind == 2 else 1


def sum_of_terms(plan: Any, xp: Any, values: Any, factors: Any, weights: Any) -> Any:
    """Terms of a transform of type 2 of the same modes, each with factors of its own, weighted and added up.

    Parameters
    ----------
    plan
        A transform, its points set.
    xp
        Module of the arrays.
    values
        Modes, of the shape of one term.
    factors
        Of modes, shape (terms, modes).
    weights
        Of points, shape (terms, points).
    """
    if hasattr(plan, "weighted"):
        return plan.weighted(values, factors, weights)
    modes = xp.ascontiguousarray(factors * values)
    return (weights * plan.execute(modes if len(modes) > 1 else modes[0])).sum(axis=0)


def adjoint_of_terms(plan: Any, xp: Any, values: Any, factors: Any, weights: Any) -> Any:
    """Conjugate transpose of :func:`sum_of_terms`, by a transform of type 1: modes from values at points."""
    if hasattr(plan, "weighted"):
        return plan.weighted(values, factors, weights)
    strength = xp.ascontiguousarray(weights.conj() * values)
    modes = plan.execute(strength if len(strength) > 1 else strength[0]).reshape(factors.shape)
    return (factors.conj() * modes).sum(axis=0)


def folded(angles: Any, dtype: np.dtype[Any]) -> Any:
    """Angles of points within half a turn; folded in float64, for the sake of single precision."""
    real = np.float32 if dtype == np.complex64 else np.float64
    return ((angles + np.pi) % (2.0 * np.pi) - np.pi).astype(real)
