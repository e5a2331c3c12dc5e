"""Files cut short, changed and rearranged, as the tests of every reader want them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from lensdesign import InputError

NUMBERS = [
    b"nan",
    b"inf",
    b"-inf",
    b"1e999",
    b"-0",
    b"-0.0",
    b"0",
    b"-1",
    b"1e-320",
    b"-1e308",
    b"99999999999999999999999",
    b"9" * 5000,
    b"1_0",
    b"0x1F",
    b"\xd9\xa1",
    b"true",
    b'""',
    b"[]",
    b"2147483648",
]


def malformed(data: bytes, rng: np.random.Generator, own: Sequence[bytes] = ()) -> bytes:
    """One of many ways in which a file can be spoilt; `own` are words of its own format."""
    ways: list[Callable[[bytes, np.random.Generator], bytes]] = [
        _cut,
        _cut_at_line,
        _flipped,
        _bits,
        _line_gone,
        _line_twice,
        _lines_swapped,
        _nul,
        _piece_gone,
        _piece_twice,
        _recoded,
        _line_ends,
        lambda d, r: _number(d, r, [*NUMBERS, *own]),
        lambda d, r: _number(d, r, [*NUMBERS, *own]),
        lambda d, r: _number(d, r, [*NUMBERS, *own]),
        lambda d, r: _word(d, r, [*NUMBERS, *own]),
        lambda d, r: _nested(d, r),
    ]
    result = bytes(data)
    for _ in range(1 + int(rng.integers(2))):
        result = ways[rng.integers(len(ways))](result, rng)
    return result


def outcomes(
    path: Path, files: Sequence[bytes], read: Callable[[Path], object], check: Callable[[object], bool]
) -> list[bool]:
    """Read each; True where it was read, with `check` of the result, False where a fault was reported.

    Any other exception, a fault that does not name the file or one that it names, or a file beside it is an
    error.
    """
    found = []
    for number, content in enumerate(files):
        path.write_bytes(content)
        os.utime(path, ns=(number, number))  # another time for each, or a cache would take it for the last
        before = sorted(path.parent.iterdir())
        try:
            result = read(path)
        except InputError as error:
            message = str(error)
        else:
            message = ""
            assert check(result), content[:500]
        if message:
            assert str(path.parent) in message, message[:500]
        found.append(not message)
        assert sorted(path.parent.iterdir()) == before
    return found


def _place(data: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(len(data))) if data else 0


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: _place(data, rng)]


def _cut_at_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    return b"\n".join(lines[: rng.integers(len(lines))])


def _flipped(data: bytes, rng: np.random.Generator) -> bytes:
    result = bytearray(data)
    for _ in range(rng.integers(1, 6) if data else 0):
        result[_place(data, rng)] = rng.integers(256)
    return bytes(result)


def _bits(data: bytes, rng: np.random.Generator) -> bytes:
    result = bytearray(data)
    if data:
        result[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(result)


def _of_lines(data: bytes, rng: np.random.Generator) -> tuple[list[bytes], int, int]:
    lines = data.split(b"\n")
    i, j = (int(v) for v in rng.integers(len(lines), size=2))
    return lines, i, j


def _line_gone(data: bytes, rng: np.random.Generator) -> bytes:
    lines, i, _ = _of_lines(data, rng)
    return b"\n".join(lines[:i] + lines[i + 1 + int(rng.integers(3)) :])


def _line_twice(data: bytes, rng: np.random.Generator) -> bytes:
    lines, i, j = _of_lines(data, rng)
    return b"\n".join([*lines[:j], lines[i], *lines[j:]])


def _lines_swapped(data: bytes, rng: np.random.Generator) -> bytes:
    lines, i, j = _of_lines(data, rng)
    lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines)


def _nul(data: bytes, rng: np.random.Generator) -> bytes:
    place = _place(data, rng)
    return data[:place] + b"\0" * int(rng.integers(1, 5)) + data[place:]


def _piece_gone(data: bytes, rng: np.random.Generator) -> bytes:
    place = _place(data, rng)
    return data[:place] + data[place + int(rng.integers(1, 40)) :]


def _piece_twice(data: bytes, rng: np.random.Generator) -> bytes:
    place = _place(data, rng)
    return data[:place] + data[place : place + int(rng.integers(1, 200))] + data[place:]


def _recoded(data: bytes, rng: np.random.Generator) -> bytes:
    text = data.decode("latin-1")
    kind = ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "utf-32", "utf-7"][rng.integers(6)]
    return text.encode(kind)


def _line_ends(data: bytes, rng: np.random.Generator) -> bytes:
    return data.replace(b"\n", [b"\r\n", b"\r", b"\n\n", b"\x0b", b"\x85", b"\n\r", b""][rng.integers(7)])


def _number(data: bytes, rng: np.random.Generator, values: Sequence[bytes]) -> bytes:
    """Another value for one of the numbers."""
    spans = [m.span() for m in re.finditer(rb"[-+]?\d[\d.eE+-]*", data)]
    if not spans:
        return data
    start, end = spans[rng.integers(len(spans))]
    return data[:start] + values[rng.integers(len(values))] + data[end:]


def _word(data: bytes, rng: np.random.Generator, values: Sequence[bytes]) -> bytes:
    words = data.split(b" ")
    words[rng.integers(len(words))] = values[rng.integers(len(values))]
    return b" ".join(words)


def _nested(data: bytes, rng: np.random.Generator) -> bytes:
    place, count = _place(data, rng), int(rng.integers(1, 20_000))
    opened = [b"[", b"{a=", b"a.", b"[[", b"<a>", b"(", b"\n[a.b.c]\n"][rng.integers(7)]
    return data[:place] + opened * (count if len(opened) < 4 else count // 20) + data[place:]
