"""A stand-in for CuPy where no GPU is there: NumPy's arrays behind a wall.

As with CuPy, nothing takes one of these arrays beside one of NumPy's, and none becomes one of NumPy's unless
`get` is called. The module itself is the array module, and a back end of `scipy.fft` that, as CuPy's, takes
no number of workers. `device` is one for engines, with transforms as strict as cuFINUFFT's.
"""

from __future__ import annotations

import operator
from typing import Any

import finufft
import numpy as np

from wavesim.runtime.device import Device

__ua_domain__ = "numpy.scipy.fft"

TAKING_ANY = ("asarray",)


class DeviceArray:
    """An array of the stand-in."""

    __array_ufunc__ = None

    def __init__(self, held: np.ndarray) -> None:
        self.held = held

    def __array__(self, *_: Any, **__: Any) -> np.ndarray:
        raise TypeError("an array of a device does not become one of NumPy's by itself")

    def get(self) -> np.ndarray:
        return self.held.copy()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        found = getattr(self.held, name)
        return _walled(found) if callable(found) else _wrapped(found)

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "held":
            object.__setattr__(self, name, value)
        else:
            setattr(self.held, name, _own(value))

    def __getitem__(self, place: Any) -> Any:
        return _wrapped(self.held[_own(place)])

    def __setitem__(self, place: Any, value: Any) -> None:
        self.held[_own(place)] = _own(value)

    def __len__(self) -> int:
        return len(self.held)

    def __iter__(self) -> Any:
        return (_wrapped(row) for row in self.held)

    def __complex__(self) -> complex:
        return complex(self.held)


def _operation(name: str) -> Any:
    work = getattr(operator, name)
    return lambda self, *others: _wrapped(work(self.held, *(_own(other) for other in others)))


def _reflected(name: str) -> Any:
    work = getattr(operator, name)
    return lambda self, other: _wrapped(work(_own(other), self.held))


def _in_place(name: str) -> Any:
    work = getattr(operator, name)

    def change(self: DeviceArray, other: Any) -> DeviceArray:
        self.held = work(self.held, _own(other))
        return self

    return change


for _name in ("add", "sub", "mul", "truediv", "matmul", "and_", "mod", "pow"):
    _short = _name.strip("_")
    setattr(DeviceArray, f"__{_short}__", _operation(_name))
    setattr(DeviceArray, f"__r{_short}__", _reflected(_name))
    setattr(DeviceArray, f"__i{_short}__", _in_place("i" + _short if _short != "and" else "iand"))
for _name in ("lt", "le", "gt", "ge", "eq", "ne", "neg", "abs", "invert"):
    setattr(DeviceArray, f"__{_name}__", _operation(_name))


def _own(value: Any) -> Any:
    """NumPy's array in one of the stand-in; a bare one of NumPy's is refused."""
    if isinstance(value, DeviceArray):
        return value.held
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError("an array of NumPy's beside one of a device")
    if isinstance(value, tuple | list):
        return type(value)(_own(part) for part in value)
    return value


def _wrapped(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return DeviceArray(value)
    if isinstance(value, tuple) and any(isinstance(part, np.ndarray) for part in value):
        return tuple(_wrapped(part) for part in value)
    return value


def _walled(function: Any, own: Any = _own) -> Any:
    def call(*given: Any, **named: Any) -> Any:
        return _wrapped(function(*map(own, given), **{name: own(value) for name, value in named.items()}))

    return call


def __getattr__(name: str) -> Any:
    if name.startswith("__"):
        raise AttributeError(name)
    found = getattr(np, name)
    if isinstance(found, type) or not callable(found):
        return found
    if name in TAKING_ANY:
        return _walled(found, lambda value: value.held if isinstance(value, DeviceArray) else value)
    return _walled(found)


def __ua_convert__(dispatchables: Any, _: bool) -> Any:
    values = [part.value for part in dispatchables]
    return values if all(isinstance(value, DeviceArray) for value in values) else NotImplemented


def __ua_function__(method: Any, given: Any, named: dict[str, Any]) -> Any:
    if "workers" in named:
        raise TypeError("unexpected keyword argument 'workers'")
    return _walled(getattr(np.fft, method.__name__))(
        *given, **{name: value for name, value in named.items() if name != "overwrite_x"}
    )


class Plan:
    """A nonuniform transform of FINUFFT that takes what cuFINUFFT takes."""

    def __init__(self, kind: int, shape: tuple[int, ...], precision: Any) -> None:
        sign = -1 if kind == 2 else 1
        self.dtype = precision.dtype
        error = precision.transform_error
        self.plan = finufft.Plan(
            kind, shape[1:], shape[0], error, sign, dtype=self.dtype.name, nthreads=1, showwarn=0
        )

    def setpts(self, *points: DeviceArray) -> None:
        assert all(p.held.dtype == np.float32 and p.held.flags.c_contiguous for p in points)
        self.plan.setpts(*(p.held for p in points))

    def execute(self, data: DeviceArray) -> DeviceArray:
        assert data.held.dtype == self.dtype
        assert data.held.flags.c_contiguous
        return DeviceArray(self.plan.execute(data.held))


def device(memory_bytes: int = 100_000_000) -> Device:
    """The stand-in, with so much memory free for one step."""
    import stand_in_device

    return Device("gpu", stand_in_device, Plan, lambda: (2 * memory_bytes, 2 * memory_bytes))
