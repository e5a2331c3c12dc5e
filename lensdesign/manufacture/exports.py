"""What a lens is exported as, by the suffix of the file: the one place that names all formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lensdesign.analysis.outline import DrawnOutline, drawn_outline
from lensdesign.errors import InputError
from lensdesign.files.formats import LENS_FORMATS, write_lens_file
from lensdesign.lens.solid import glass_elements
from lensdesign.manufacture.mesh.writing import MESH_SUFFIXES
from lensdesign.manufacture.step.occ import STEP_SUFFIXES

if TYPE_CHECKING:
    from lensdesign.lens.lens import Lens


@dataclass(frozen=True)
class Exported:
    """A file that was written.

    Attributes
    ----------
    sentence
        What it is, in a few words.
    figures
        Its figures, for JSON.
    outline
        The outline of each element in one sentence.
    """

    sentence: str
    figures: dict[str, Any]
    outline: tuple[str, ...] = ()


@dataclass(frozen=True)
class ExportOptions:
    """How a lens is exported.

    Attributes
    ----------
    chord_error_um
        Of meshes: largest distance from the true optical surfaces.
    measured
        Of meshes: whether surfaces have their measured figures.
    report
        Told in one sentence of each surface whose measured figure is left out.
    """

    chord_error_um: float
    measured: bool
    report: Callable[[str], None]


@dataclass(frozen=True)
class ExportFormat:
    """A kind of file, and what writes it."""

    kind: str
    write: Callable[[Lens, Path, ExportOptions], Exported]


def export_lens(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    """Write a lens as the format that the suffix of the file names.

    Bodies of glass have the outline of :func:`lensdesign.analysis.outline.drawn_outline`, which a drawing of
    the same lens has too. With measured figures, which end at the clear aperture, they have the edges of the
    design alone.

    Raises
    ------
    InputError
        If no format has the suffix, or the format cannot hold the lens; no file is written then.
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
        report=options.report,
        measured=options.measured,
        statement="; ".join(statements),
    )
    figures = {
        "file": str(path),
        "triangles": mesh.triangles,
        "chord_error_um": mesh.chord_error_um,
        "edge_error_um": mesh.edge_error_um,
        "volume_mm3": mesh.volume_mm3,
        "exact_volume_mm3": mesh.exact_volume_mm3,
        "surfaces_without_their_figure": [] if options.measured else _with_figure(lens),
        "outline": list(statements),
        "ground_diameters_mm": [] if figured else _diameters(outline),
    }
    sentence = (
        f"{mesh.triangles} triangles, within {mesh.chord_error_um:.3g} um of the true surface, "
        f"volume {mesh.volume_mm3:.6g} mm^3 (exact {mesh.exact_volume_mm3:.6g} mm^3)"
    )
    return Exported(sentence, figures, statements)


def _step(lens: Lens, path: Path, options: ExportOptions) -> Exported:
    from lensdesign.manufacture.step.writing import write_step

    if options.measured:
        raise InputError(
            f"cannot write {path} with --measured: solids have nominal surfaces; a mesh takes it"
        )
    outline = drawn_outline(lens)
    found = write_step(outline.lens, path, report=options.report, statement="; ".join(outline.statements))
    figures = {
        "file": str(path),
        "bytes": found.bytes,
        "solids": [asdict(body) for body in found.bodies],
        "surfaces_without_their_figure": _with_figure(lens),
        "outline": list(outline.statements),
        "ground_diameters_mm": _diameters(outline),
    }
    sentence = (
        f"{found.solids} {'solid' if found.solids == 1 else 'solids'}, read back within "
        f"{1e6 * found.largest_error_mm:.2g} nm of the true surface, volume {found.volume_mm3:.9g} mm^3 "
        f"(exact {found.exact_volume_mm3:.9g} mm^3)"
    )
    return Exported(sentence, figures, outline.statements)


def _lens_file(lens: Lens, path: Path, _options: ExportOptions) -> Exported:
    write_lens_file(lens, path)
    surfaces = len(lens.surfaces)
    return Exported(f"{surfaces} surfaces", {"file": str(path), "surfaces": surfaces})


def _measured_outline(lens: Lens) -> tuple[str, ...]:
    """Outline of bodies with measured figures, which end at the clear apertures."""
    return tuple(
        f"{element.name}: diameter {2.0 * element.edge_mm:g} mm, that of "
        + (
            "the design's [[edge]]"
            if element.edge.semi_diameter_mm
            else "the clear aperture, without the ground edge of a drawing: measured figures end there"
        )
        for element in glass_elements(lens)
    )


def _diameters(outline: DrawnOutline) -> list[float]:
    return [edge.diameter_mm for edge in outline.edges]


def _with_figure(lens: Lens) -> list[int]:
    return [i for i, surface in enumerate(lens.surfaces, start=1) if surface.figure]


EXPORT_FORMATS = {
    **dict.fromkeys(MESH_SUFFIXES, ExportFormat("mesh", _mesh)),
    **dict.fromkeys(STEP_SUFFIXES, ExportFormat("exact solid", _step)),
    **dict.fromkeys(LENS_FORMATS, ExportFormat("lens file", _lens_file)),
}


def export_kinds() -> str:
    """All kinds with their suffixes, in words: `mesh (.stl, ...), exact solid (...) or lens file (...)`."""
    kinds: dict[str, list[str]] = {}
    for suffix, made in EXPORT_FORMATS.items():
        kinds.setdefault(made.kind, []).append(suffix)
    *some, last = (f"{kind} ({', '.join(suffixes)})" for kind, suffixes in kinds.items())
    return f"{', '.join(some)} or {last}"
