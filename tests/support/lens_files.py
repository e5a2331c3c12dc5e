"""What the tests of other programs' lens files share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lensdesign import Lens
from lensdesign.lens.shapes.even_asphere import without_zeros


def bare(lens: Lens) -> Lens:
    """A lens whose aspheres have no zeros at their end."""
    return lens.replaced(surfaces=tuple(s.replaced(asphere=without_zeros(s.asphere)) for s in lens.surfaces))


def mutilated(data: bytearray, rng: np.random.Generator, own: Sequence[bytes]) -> bytes:
    """A file cut short, with bytes changed, lines exchanged or left out, or other words, `own` among them."""
    kind = rng.integers(5)
    if kind == 0:
        return bytes(data[: rng.integers(len(data))])
    if kind == 1:
        for _ in range(rng.integers(1, 6)):
            data[rng.integers(len(data))] = rng.integers(256)
        return bytes(data)
    lines = bytes(data).split(b"\n")
    i, j = rng.integers(len(lines), size=2)
    if kind == 2:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 3:
        del lines[min(i, j) : min(i, j) + 1 + int(rng.integers(3))]
    else:
        values = [b"nan", b"-1e308", b"0", b"1e-320", b"99999999999999999999", b"\xff\xfe", *own]
        words = lines[i].split(b" ")
        words[-1] = values[rng.integers(len(values))]
        lines[i] = b" ".join(words)
    return b"\n".join(lines)
