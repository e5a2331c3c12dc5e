"""Export of a lens; the suffix of the file selects the format. This module is the registry of formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.analysis.outline import DrawnOutline, drawn_outline
from lensdesign.common.text import alternatives
from lensdesign.errors import InputError
from lensdesign.files.formats import WRITTEN_LENS_FORMATS, write_lens_file
from lensdesign.lens.solid import glass_elements
from lensdesign.manufacture.dxf.outline import DXF_SUFFIX
from lensdesign.manufacture.mesh.writing import MESH_SUFFIXES
from lensdesign.manufacture.step.step_files import STEP_SUFFIXES

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class Exported:
    """Description of an exported file.

    Attributes
    ----------
    sentence
        Summary of the contents.
    values
        Numbers of the export, for JSON.
    outline
        One sentence on the outline of each element.
    """

    sentence: str
    values: dict[str, Any]
    outline: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    chord_error_um
        Largest distance of a mesh's facets from the exact optical surfaces in um; meshes only.
    measured
        Whether surfaces have their measured figures; meshes only.
    warn
        Called with one sentence for each surface whose measured figure, coating or roughness is omitted.
    """

    chord_error_um: float
    measured: bool
    warn: Callable[[str], None]


@dataclass(frozen=True)
class ExportFormat:
    """A kind of file and the function that writes it."""

    kind: str
    write: Callable[[Lens, Path, ExportOptions], Exported]


def export_lens(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    """Write a lens to a file; the suffix of the file selects the format.

    The glass bodies have the outline of :func:`lensdesign.analysis.outline.drawn_outline`, like a drawing of
    the same lens. Measured figures end at the clear aperture; bodies with measured figures therefore have
    the edges of the design only.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write.
    options
        Accuracy and contents of the export.

    Returns
    -------
    Exported
        Summary and numbers of the written file.

    Raises
    ------
    InputError
        If no format has the suffix, or the format cannot represent the lens. No file is written then.
    """
    suffix = path.suffix.lower()
    if suffix not in EXPORT_FORMATS:
        raise InputError(f"cannot write {path}: unknown suffix {suffix!r}; allowed: {export_kinds()}")
    return EXPORT_FORMATS[suffix].write(lens, path, options)


def _mesh(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    from lensdesign.manufacture.mesh.mesh import write_mesh

    outline = drawn_outline(lens)
    figured = options.measured and any(surface.figure for surface in lens.surfaces)
    statements = _measured_outline(lens) if figured else outline.statements
    mesh = write_mesh(
        lens if figured else outline.lens,
        path,
        options.chord_error_um,
        warn=options.warn,
        measured=options.measured,
        statement="; ".join(statements),
    )
    values = {
        "file": str(path),
        "triangles": mesh.triangles,
        "chord_error_um": mesh.chord_error_um,
        "edge_error_um": mesh.edge_error_um,
        "volume_mm3": mesh.volume_mm3,
        "exact_volume_mm3": mesh.exact_volume_mm3,
        "surfaces_without_their_figure": [] if options.measured else _surfaces_with_figure(lens),
        "outline": list(statements),
        "ground_diameters_mm": [] if figured else _diameters(outline),
    }
    sentence = (
        f"{mesh.triangles} triangles, within {mesh.chord_error_um:.3g} µm of the true surface, "
        f"volume {mesh.volume_mm3:.6g} mm³ (exact {mesh.exact_volume_mm3:.6g} mm³)"
    )
    return Exported(sentence, values, statements)


def _step(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    from lensdesign.manufacture.step.writing import write_step

    outline = _nominal_outline(lens, path, options, "solids")
    found = write_step(outline.lens, path, warn=options.warn, statement="; ".join(outline.statements))
    values = {
        "file": str(path),
        "bytes": found.bytes,
        "solids": [asdict(body) for body in found.bodies],
        **_nominal_values(lens, outline),
    }
    sentence = (
        f"{found.solids} {'solid' if found.solids == 1 else 'solids'}, read back within "
        f"{1e6 * found.largest_error_mm:.2g} nm of the true surface, volume {found.volume_mm3:.9g} mm³ "
        f"(exact {found.exact_volume_mm3:.9g} mm³)"
    )
    return Exported(sentence, values, outline.statements)


def _outline(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    from lensdesign.manufacture.dxf.outline import write_outline

    outline = _nominal_outline(lens, path, options, "outlines")
    found = write_outline(outline.lens, path, warn=options.warn, statement="; ".join(outline.statements))
    values = {
        "file": str(path),
        "bytes": found.bytes,
        "elements": found.elements,
        "curves": [asdict(curve) for curve in found.curves],
        **_nominal_values(lens, outline),
    }
    sentence = (
        f"section of {found.elements} {'element' if found.elements == 1 else 'elements'}, read back within "
        f"{1e6 * found.largest_deviation_mm:.2g} nm of the true surface"
    )
    return Exported(sentence, values, outline.statements)


def _nominal_outline(lens: Lens, path: Path, options: ExportOptions, what: str) -> DrawnOutline:
    """Return the outline for a file with nominal surfaces; refuse the request for measured ones."""
    if options.measured:
        raise InputError(
            f"cannot write {path} with --measured: {what} have nominal surfaces; write a mesh instead"
        )
    return drawn_outline(lens)


def _nominal_values(lens: Lens, outline: DrawnOutline) -> dict[str, Any]:
    """Return what all files with nominal surfaces state."""
    return {
        "surfaces_without_their_figure": _surfaces_with_figure(lens),
        "outline": list(outline.statements),
        "ground_diameters_mm": _diameters(outline),
    }


def _lens_file(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    write_lens_file(lens, path, warn=options.warn)
    surfaces = len(lens.surfaces)
    values = {
        "file": str(path),
        "surfaces": surfaces,
        "surfaces_without_their_coating": [
            i for i, surface in enumerate(lens.surfaces, start=1) if surface.coating != "ideal"
        ],
        "surfaces_without_their_roughness": [
            i for i, surface in enumerate(lens.surfaces, start=1) if surface.roughness is not None
        ],
    }
    return Exported(f"{surfaces} surfaces", values)


def _measured_outline(lens: Lens) -> tuple[str, ...]:
    """Return one sentence on the outline of each body with measured figures."""
    return tuple(
        f"{element.name}: diameter {2.0 * element.edge_mm:g} mm "
        + (
            "(from the design's [[edge]])"
            if element.edge.semi_diameter_mm
            else "(clear aperture, where measured figures end), without the ground edge of a drawing"
        )
        for element in glass_elements(lens)
    )


def _diameters(outline: DrawnOutline) -> list[float]:
    return [edge.diameter_mm for edge in outline.edges]


def _surfaces_with_figure(lens: Lens) -> list[int]:
    return [i for i, surface in enumerate(lens.surfaces, start=1) if surface.figure]


EXPORT_FORMATS = {
    **dict.fromkeys(MESH_SUFFIXES, ExportFormat("mesh", _mesh)),
    **dict.fromkeys(STEP_SUFFIXES, ExportFormat("exact solid", _step)),
    DXF_SUFFIX: ExportFormat("outline in section", _outline),
    **dict.fromkeys(WRITTEN_LENS_FORMATS, ExportFormat("lens file", _lens_file)),
}


def export_kinds() -> str:
    """Return all kinds with their suffixes: `mesh (.stl, ...), exact solid (...) or lens file (...)`."""
    kinds: dict[str, list[str]] = {}
    for suffix, export_format in EXPORT_FORMATS.items():
        kinds.setdefault(export_format.kind, []).append(suffix)
    return alternatives(f"{kind} ({', '.join(suffixes)})" for kind, suffixes in kinds.items())
