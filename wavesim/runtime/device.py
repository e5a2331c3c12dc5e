"""Devices that hold and process arrays: the processor, or a graphics processor (GPU).

Code for a device uses only its array module, so that the same lines run with NumPy and with CuPy. Nonuniform
Fourier transforms come from FINUFFT, from cuFINUFFT or, of several terms on a plane in single precision, from
:mod:`wavesim.runtime.fourier.terms`; all have the same methods.
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


@dataclass(frozen=True)
class Precision:
    """Precision of the computation of a part of a field.

    Attributes
    ----------
    dtype : numpy dtype
        complex64 or complex128.
    transform_error : float
        Relative error of the nonuniform Fourier transform.
    interpolation_error : float
        Relative error of the interpolation from a coarse grid.
    """

    dtype: np.dtype[Any]
    transform_error: float
    interpolation_error: float


MakePlan = Callable[[int, tuple[int, ...], Precision], Any]
"""Creates a nonuniform Fourier transform of type 2 or 1; shape (transforms, modes along y, modes along x)."""


@dataclass(frozen=True, eq=False)
class Device:
    """An array module with its Fourier transforms and its memory.

    Attributes
    ----------
    name : str
        One of `DEVICES`.
    xp : module
        NumPy or CuPy.
    plan : callable
        Creates a nonuniform Fourier transform, whose points are set by `setpts`.
    memory : callable
        Gives the free bytes and all bytes of the device's memory.
    """

    name: str
    xp: Any
    plan: MakePlan
    memory: Callable[[], tuple[int, int]]

    def to_device(self, values: Any, dtype: Any = None) -> Any:
        """Return a C-contiguous array of the device, without a copy where it is one already."""
        return self.xp.ascontiguousarray(self.xp.asarray(values, dtype=dtype))

    def to_host(self, values: Any) -> NDArray[Any]:
        """Return an array in this computer's memory."""
        return np.asarray(values.get() if hasattr(values, "get") else values)

    @property
    def memory_bytes(self) -> int:
        """Memory that one step may use: half of the free memory."""
        return self.memory()[0] // 2


def device_named(name: str) -> Device:
    """Return a device, after a check that it works.

    Parameters
    ----------
    name
        "cpu": NumPy and this computer's memory. "gpu": CuPy and cuFINUFFT.

    Raises
    ------
    InputError
        If there is no device of this name, its packages are not installed, or no GPU responds.
    """
    if name == "cpu":
        # Memory that a step may use on the processor.
        host_bytes = 1_000_000_000
        return Device("cpu", np, plan_of_terms, lambda: (host_bytes, host_bytes))
    if name != "gpu":
        raise InputError(
            f"device = {name!r}: there is no such device; allowed: {', '.join(DEVICES)}"
            f"{did_you_mean(name, DEVICES)}"
        )
    cupy, cufinufft = (_module(module) for module in ("cupy", "cufinufft"))
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
        raise InputError(
            f"device = 'gpu': {name} cannot be imported ({error}); install transferlens with its extra gpu "
            "(pip install 'transferlens[gpu]')"
        ) from error


def _gpu_memory(cupy: Any) -> tuple[int, int]:
    """Return the free bytes, including those that CuPy keeps for its next arrays, and all bytes."""
    free, total = cupy.cuda.runtime.memGetInfo()
    return int(free) + int(cupy.get_default_memory_pool().free_bytes()), int(total)


def plan_of_terms(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """Return the fastest transform for a number of threads, as :func:`fourier_plan`."""
    # Threads of FINUFFT that are as fast as one thread of the transform of terms.
    worth_threads = 3
    if precision.dtype != np.complex64 or len(shape) != 3 or threads > worth_threads:
        return fourier_plan(kind, shape, precision, threads)
    from wavesim.runtime.fourier.terms import TermsTransform

    return TermsTransform(kind, shape, precision.transform_error)


def fourier_plan(kind: int, shape: tuple[int, ...], precision: Precision, threads: int = 1) -> Any:
    """Return a nonuniform transform of FINUFFT of type 2, or of type 1, its conjugate transpose.

    Parameters
    ----------
    kind
        Type of the transform, 2 or 1.
    shape
        Number of transforms, then of modes along each axis.
    precision
        Data type and error of the transform.
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
    """Return type, modes, number of transforms, error and sign, as both libraries expect them."""
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
