"""3MF files (3D Manufacturing Format, Core Specification 1.3): a zip archive that holds an XML model.

Only the model is unpacked, piece by piece and to a bound; the XML may have no document type, and so no
entities. Objects, components with transforms and build items are read; models in several parts (the
Production Extension) are not.
"""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from array import array
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.input_files import MESH_BYTES
from lensdesign.errors import InputError
from lensdesign.fabrication.mesh.reading import TriangleMesh, coordinates, refuse_count

MOST_ENTRIES = 1000
MOST_DEPTH = 32
"""Components within components."""

BLOCK_BYTES = 2**20

UNITS_MM = {
    "micron": 1e-3,
    "millimeter": 1.0,
    "centimeter": 10.0,
    "inch": 25.4,
    "foot": 304.8,
    "meter": 1000.0,
}

Transform = NDArray[np.float64]


@dataclass
class _Object:
    """One object: its own triangles, and others placed in it as (id, transform)."""

    values: array[float] = field(default_factory=lambda: array("d"))
    faces: array[int] = field(default_factory=lambda: array("q"))
    parts: list[tuple[str, Transform]] = field(default_factory=list)


@dataclass
class _Model:
    """The model while it is being read."""

    unit_mm: float = 1.0
    objects: dict[str, _Object] = field(default_factory=dict)
    items: list[tuple[str, Transform]] = field(default_factory=list)
    current: _Object | None = None


def read_three_mf(data: bytes) -> TriangleMesh:
    """Triangles in mm of all items that a 3MF file's content builds.

    Raises
    ------
    InputError
        If it is no 3MF file, would unpack to more than 1 GB or 20 million triangles, names paths outside of
        itself, or is malformed.
    """
    model = _Model()
    if data.count(b"PK\x01\x02") > MOST_ENTRIES:
        raise InputError(f"an archive of more than {MOST_ENTRIES} entries")
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            _parse(archive, _model_entry(archive), model)
    except InputError:
        raise
    except (expat.ExpatError, LookupError) as error:  # also unknown encodings
        raise InputError(f"its model is not valid XML: {error}") from error
    except (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, ValueError) as error:
        raise InputError(f"not a whole zip archive: {error}") from error
    except RuntimeError as error:  # encrypted, or packed in a way that is not known
        raise InputError(f"its model cannot be unpacked: {error}") from error
    return _built(model)


def _model_entry(archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    """The one entry with the model; entries that lead out of the archive are refused."""
    entries = archive.infolist()
    for entry in entries:
        parts = entry.filename.replace("\\", "/").split("/")
        if not parts[0] or ".." in parts or ":" in parts[0]:
            raise InputError(f"an archive with the path {entry.filename[:60]!r}, which leads out of it")
    models = [e for e in entries if e.filename.lower().endswith(".model")]
    if len(models) != 1:
        raise InputError(f"{len(models)} models in it; there must be one")
    if models[0].file_size > MESH_BYTES:
        raise InputError(f"a model of {models[0].file_size} bytes; at most {MESH_BYTES} are unpacked")
    return models[0]


def _parse(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, model: _Model) -> None:
    parser = expat.ParserCreate()

    def refuse_type(*_: object) -> None:
        raise InputError("its model has a document type, which may hold entities")

    def start(name: str, attributes: dict[str, str]) -> None:
        _take(model, name.rpartition(":")[2], attributes, f"line {parser.CurrentLineNumber}")

    def end(name: str) -> None:
        if name.rpartition(":")[2] == "object":
            model.current = None

    parser.StartDoctypeDeclHandler = refuse_type
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    left = MESH_BYTES
    with archive.open(entry) as file:
        while block := file.read(BLOCK_BYTES):
            left -= len(block)
            if left < 0:  # the archive's own table of sizes may lie
                raise InputError(f"a model of more than {MESH_BYTES} bytes")
            parser.Parse(block, False)
            if MESH_BYTES - left - parser.CurrentByteIndex > 2 * BLOCK_BYTES:
                raise InputError(f"its model has a tag of more than {BLOCK_BYTES} bytes")
    parser.Parse(b"", True)


def _take(model: _Model, name: str, attributes: dict[str, str], where: str) -> None:
    """Take the start of an element."""
    if name == "vertex" and model.current is not None:
        words = [attributes.get(axis, "").strip().encode() for axis in "xyz"]
        model.current.values.extend(coordinates(words, where))
    elif name == "triangle" and model.current is not None:
        model.current.faces.extend(_corners(attributes, where))
        refuse_count(len(model.current.faces) // 3)
    elif name == "component" and model.current is not None:
        model.current.parts.append(_placed(attributes, where))
    elif name == "object":
        key = attributes.get("id", "")
        if key in model.objects:
            raise InputError(f"{where}: object {key[:40]!r} stands twice")
        model.current = model.objects[key] = _Object()
    elif name == "item":
        model.items.append(_placed(attributes, where))
    elif name == "model":
        unit = attributes.get("unit", "millimeter")
        if unit not in UNITS_MM:
            raise InputError(f"{where}: unit {unit[:40]!r}; known are {', '.join(UNITS_MM)}")
        model.unit_mm = UNITS_MM[unit]


def _corners(attributes: dict[str, str], where: str) -> list[int]:
    words = [attributes.get(name, "") for name in ("v1", "v2", "v3")]
    if not all(word.isascii() and word.isdigit() and len(word) < 12 for word in words):
        raise InputError(f"{where}: {' '.join(words)[:40]!r} are no three vertices")
    return [int(word) for word in words]


def _placed(attributes: dict[str, str], where: str) -> tuple[str, Transform]:
    """The object that an item or component places, and its transform as a matrix for row vectors, (4, 3)."""
    words = attributes.get("transform", "1 0 0 0 1 0 0 0 1 0 0 0").split()
    if len(words) != 12:
        raise InputError(f"{where}: a transform of {len(words)} numbers; it has 12")
    rows = [coordinates([w.encode() for w in words[i : i + 3]], where) for i in range(0, 12, 3)]
    if any(name.rpartition(":")[2] == "path" for name in attributes):
        raise InputError(f"{where}: an object of another part; models in several parts are not read")
    return attributes.get("objectid", ""), np.array(rows)


def _built(model: _Model) -> TriangleMesh:
    """All items, each object as often as it is placed."""
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    total, placed, first = 0, 0, 0
    waiting = [(key, transform, 0) for key, transform in reversed(model.items)]
    while waiting:
        key, transform, depth = waiting.pop()
        if key not in model.objects:
            raise InputError(f"object {key[:40]!r} is placed, and does not exist")
        if depth > MOST_DEPTH:
            raise InputError(f"components more than {MOST_DEPTH} deep, or within themselves")
        found = model.objects[key]
        placed += 1
        total += len(found.faces) // 3 + len(found.parts)
        refuse_count(total)
        if placed > 10 * MOST_ENTRIES:
            raise InputError(f"more than {10 * MOST_ENTRIES} objects placed")
        waiting += [(k, _chained(t, transform), depth + 1) for k, t in reversed(found.parts)]
        if len(found.faces):
            own = np.array(found.values, float).reshape(-1, 3)
            corners = np.array(found.faces, dtype=np.int64).reshape(-1, 3)
            if corners.max() >= len(own):
                raise InputError(f"object {key[:40]!r}: a triangle has a vertex that does not exist")
            with np.errstate(all="ignore"):
                vertices.append(model.unit_mm * (own @ transform[:3] + transform[3]))
            faces.append(corners + first)
            first += len(own)
    if not faces:
        raise InputError("no triangle in it")
    return TriangleMesh(np.concatenate(vertices), np.concatenate(faces))


def _chained(inner: Transform, outer: Transform) -> Transform:
    with np.errstate(all="ignore"):
        return np.concatenate([inner[:3] @ outer[:3], inner[3:] @ outer[:3] + outer[3]])
