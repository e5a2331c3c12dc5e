"""PLY files (the Stanford polygon format, 1.0): vertices and triangles, in text or binary of either order."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from lensdesign.errors import InputError
from lensdesign.fabrication.mesh.reading import TriangleMesh, coordinates, refuse_count, text_lines

LONGEST_HEADER = 65536

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass
class _Element:
    """Rows of one kind; properties are (name, type, type of the count in front of a list or "")."""

    name: str
    count: int
    properties: list[tuple[str, str, str]] = field(default_factory=list)


def read_ply(data: bytes) -> TriangleMesh:
    """Vertices and triangles of a PLY file's content.

    Raises
    ------
    InputError
        If it is no PLY file, promises more than it holds, or has faces that are no triangles.
    """
    end = data.find(b"end_header", 0, LONGEST_HEADER)
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or not start:
        raise InputError("no PLY file: 'ply' must come first, and end_header within 64 kB")
    order, elements = _header(data[:end])
    names = [element.name for element in elements]
    if sorted(n for n in names if n in ("vertex", "face")) != ["face", "vertex"]:
        raise InputError(f"elements {', '.join(names)[:80]}; there must be one vertex and one face")
    refuse_count(next(e.count for e in elements if e.name == "face"))
    return _read_text(data[start:], elements) if not order else _read_binary(data, start, order, elements)


def _header(data: bytes) -> tuple[str, list[_Element]]:
    order: str | None = None
    elements: list[_Element] = []
    for where, raw in text_lines(data):
        words = [word.decode("latin-1") for word in raw]
        match words:
            case ["format", kind, "1.0"] if kind in _ORDERS and order is None:
                order = _ORDERS[kind]
            case ["element", name, count] if count.isascii() and count.isdigit() and len(count) < 12:
                elements.append(_Element(name, int(count)))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append((name, _TYPES[kind], ""))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= set(_TYPES):
                elements[-1].properties.append((name, _TYPES[kind], _TYPES[length]))
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise InputError(f"{where}: {' '.join(words)[:60]!r} is no line of a PLY header")
    if order is None:
        raise InputError("no format line; known are ascii, binary_little_endian and binary_big_endian")
    return order, elements


def _places(element: _Element) -> list[int]:
    """Positions of x, y and z among a vertex's properties."""
    names = [name for name, _, _ in element.properties]
    if any(length for _, _, length in element.properties) or not all(names.count(n) == 1 for n in "xyz"):
        raise InputError("vertices must have x, y and z, and no lists")
    return [names.index(n) for n in "xyz"]


def _corners_place(element: _Element) -> int:
    """Position of the list of corners among a face's properties."""
    lists = [i for i, (_, _, length) in enumerate(element.properties) if length]
    if len(lists) != 1 or element.properties[lists[0]][0] not in ("vertex_indices", "vertex_index"):
        raise InputError("faces must have one list, vertex_indices")
    if "f" in "".join(element.properties[lists[0]][1:]):
        raise InputError("indices of a face must be whole numbers")
    return lists[0]


def _read_text(body: bytes, elements: list[_Element]) -> TriangleMesh:
    lines = (found for found in text_lines(body) if found[1])
    values, corners = array("d"), array("q")
    for element in elements:
        if element.count > len(body):
            raise InputError(f"{element.count} rows of {element.name} promised, in {len(body)} bytes")
        places = _places(element) if element.name == "vertex" else []
        place = _corners_place(element) if element.name == "face" else 0
        for row in range(element.count):
            where, words = next(lines, ("", []))
            if not words:
                raise InputError(f"{element.count} rows of {element.name} promised, {row} found")
            here = f"{element.name} {row + 1} ({where} behind the header)"
            if element.name == "vertex":
                if len(words) != len(element.properties):
                    raise InputError(f"{here}: {len(words)} values, {len(element.properties)} promised")
                values.extend(coordinates([words[i] for i in places], here))
            elif element.name == "face":
                corners.extend(_triangle(words[place:], here))
    return TriangleMesh(
        np.array(values, float).reshape(-1, 3), np.array(corners, dtype=np.int64).reshape(-1, 3)
    )


def _triangle(words: list[bytes], where: str) -> list[int]:
    if words[:1] != [b"3"] or not all(w.isdigit() and len(w) < 12 for w in words[1:4]) or len(words) < 4:
        raise InputError(f"{where}: {b' '.join(words)[:40]!r} is no triangle (3, and three vertices from 0)")
    return [int(word) for word in words[1:4]]


def _read_binary(data: bytes, start: int, order: str, elements: list[_Element]) -> TriangleMesh:
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int64)
    done: set[str] = set()
    for element in elements:
        if {"vertex", "face"} <= done:
            break
        done.add(element.name)
        place = _corners_place(element) if element.name == "face" else -1
        places = _places(element) if element.name == "vertex" else []
        fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
        for i, (_, kind, length) in enumerate(element.properties):
            if length and i != place:
                raise InputError(f"element {element.name} has lists and stands before the faces")
            if length:
                fields.append(("length", order + length))
            fields.append((f"p{i}", order + kind, (3,)) if length else (f"p{i}", order + kind))
        row = np.dtype(fields)
        size = element.count * row.itemsize
        if size > len(data) - start:
            raise InputError(
                f"{element.count} rows of {element.name} promised, which are {size} bytes; "
                f"{len(data) - start} are left"
            )
        rows = np.frombuffer(data, row, element.count, start) if row.itemsize else np.empty(0, row)
        start += size
        if places:
            vertices = np.stack([rows[f"p{i}"].astype(float) for i in places], axis=-1)
        elif place >= 0:
            other = np.flatnonzero(rows["length"] != 3)
            if len(other):
                raise InputError(f"face {other[0] + 1} is no triangle; only those are read")
            faces = rows[f"p{place}"].astype(np.int64)
    return TriangleMesh(vertices.reshape(-1, 3), faces.reshape(-1, 3))
