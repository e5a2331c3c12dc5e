"""Design files (TOML): read with complete validation, written without loss."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.input_files import validate_inside
from lensdesign.common.toml_files import MOST_FAULTS, joined_faults, read_toml, validate
from lensdesign.errors import DesignError, InputError
from lensdesign.files.surface_coatings import check_cover_glass_coating, compile_coatings
from lensdesign.files.surface_figures import check_surface_figures
from lensdesign.lens.coatings.coating import Coating
from lensdesign.lens.cover_glass import CoverGlass
from lensdesign.lens.edges import Edge, Flange, Gate
from lensdesign.lens.lengths import LongRadiusWarning, implausible_lengths, long_radii
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface
from lensdesign.lens.surface_figure_source import SurfaceFigureSource

OfLens = TypeVar("OfLens", bound=Lens)
Part = TypeVar("Part", Surface, CoverGlass)


def load_design(path: str | os.PathLike[str]) -> Lens:
    """Read a lens from a design file.

    Parameters
    ----------
    path
        A TOML file. Its paths of glass catalogues and measured figures are relative to its folder. They must
        not lead out of this folder, unless :func:`lensdesign.common.input_files.files_from` allows another
        one.

    Returns
    -------
    Lens
        The validated lens.

    Raises
    ------
    DesignError
        If the file cannot be read or does not describe a lens. The message names file, key and value, and
        what is allowed.
    InputError
        If a measured figure cannot be read, or does not cover its surface's clear aperture.
    MaterialError
        If a glass is unknown, or its index is unknown at one of the wavelengths.

    Warns
    -----
    LongRadiusWarning
        If a radius is unusually long and a thousandth of it would be usual; it may be given in um.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> load_design("designs/paper_singlet.toml")
    <Lens 'Spatial information transfer lens, Table 1': 2 surfaces, N-BK7, field 3 mm, NA 0.5>
    """
    path = Path(path)
    return lens_of(read_toml(path), path)


def lens_of(data: dict[str, Any], path: Path) -> Lens:
    """Return the lens of a design file's tables; see :func:`load_design` for errors and warnings.

    Parameters
    ----------
    data
        Tables of the design file.
    path
        Path of the design file, which need not exist. Paths in the tables are relative to its folder, and
        messages name it.
    """
    validate_kind(data, path, "design")
    lens = validated_lens(Lens, data, path)
    catalogs = tuple((path.parent / c).resolve() for c in lens.glass_catalogs)
    for catalog in catalogs:
        validate_inside(catalog, path, "glass_catalogs", DesignError)
    surfaces = tuple(
        _with_resolved_files(surface, path, f"surface {index}")
        for index, surface in enumerate(lens.surfaces, start=1)
    )
    sensor, glass = lens.sensor, lens.sensor.cover_glass
    if glass is not None:
        glass = _with_resolved_files(glass, path, "sensor, cover_glass")
        sensor = sensor.model_copy(update={"cover_glass": glass})
    lens = lens.model_copy(update={"glass_catalogs": catalogs, "surfaces": surfaces, "sensor": sensor})
    try:
        check_surface_figures(lens)
        for wavelength in lens.wavelengths_um:
            lens.indices(wavelength)
            compile_coatings(lens, wavelength)
            check_cover_glass_coating(lens, wavelength)
            lens.cover_glass_index(wavelength)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    return lens


def validate_kind(data: Mapping[str, object], path: Path, required: str) -> None:
    """Check that a file is not of another kind than the required one.

    Parameters
    ----------
    data
        Tables of the file.
    path
        The file, for messages.
    required
        ``design`` or ``specification``.

    Raises
    ------
    DesignError
        If the tables are those of another kind of file. The message names the command for that kind.
    """
    kind = _kind(data)
    if kind in ("", required):
        return
    command = {
        "design": "lensdesign check (or draw, or export)",
        "specification": "lensdesign optimize",
        "tolerance study": "tolerancing run",
    }[kind]
    hint = {
        "design": "for example a file that lensdesign optimize has written",
        "specification": "a design with a [[variable]] for each parameter that may change",
    }[required]
    raise DesignError(f"{path}: this is a {kind}, which {command} takes; a {required} is needed here: {hint}")


def _kind(data: Mapping[str, object]) -> str:
    """Return the kind of a file according to its tables; empty if unknown."""
    if "design" in data and {"trials", "merit", "perturbation"} & data.keys():
        return "tolerance study"
    if {"optimize", "constraints", "variable"} & data.keys():
        return "specification"
    return "design" if {"surface", "object", "sensor"} <= data.keys() else ""


def validated_lens(model: type[OfLens], data: dict[str, Any], path: Path) -> OfLens:
    """Return a lens or a specification from its tables, after a check of its stop and its lengths.

    A length in another unit often violates a rule of geometry, too: surfaces cross, or end within their
    aperture. The message then names the suspicious length first.

    Parameters
    ----------
    model
        Class of the result: :class:`Lens` or a subclass.
    data
        Tables of the file.
    path
        The file, for messages.

    Raises
    ------
    DesignError
        If the tables are not valid, no surface is marked as the stop, or a length seems to be given in
        another unit.

    Warns
    -----
    LongRadiusWarning
        If a radius is unusually long, and a thousandth of it would be usual.
    """
    try:
        lens = validate(model, data, path)
    except DesignError as error:
        suspicions = [f"{path}: {sentence}" for sentence in _suspicious_lengths(data)]
        raise DesignError("\n".join([*suspicions, str(error)])) from None
    if not any(surface.stop for surface in lens.surfaces):
        raise DesignError(
            f"{path}: no surface is marked stop = true; exactly one must be: the one whose semi_diameter_mm "
            "bounds the beam, normally surface 1"
        )
    validate_lengths(lens, path)
    for sentence in long_radii(lens):
        warnings.warn(f"{path}: {sentence}", LongRadiusWarning, stacklevel=3)
    return lens


def validate_lengths(lens: Lens, source: Path) -> None:
    """Check that no length of a lens seems to be given in another unit.

    Raises
    ------
    DesignError
        If a length is implausible and another unit would explain it. The message names the source and each
        such length, with the value that may be meant.
    """
    suspicions = [f"{source}: {sentence}" for sentence in implausible_lengths(lens)]
    if suspicions:
        raise DesignError(joined_faults(suspicions))


def _suspicious_lengths(data: Mapping[str, Any]) -> list[str]:
    """Return sentences on implausible lengths of tables that are not valid; none if they cannot be read."""
    try:
        edges = [
            Edge.model_construct(
                **edge
                | {
                    key: table.model_construct(**edge[key]) if key in edge else None
                    for key, table in (("flange", Flange), ("gate", Gate))
                }
            )
            for edge in data.get("edge", ())
        ]
        surfaces = [
            Surface.model_construct(**{key: table[key] for key in table if key not in ("figure", "coating")})
            for table in data["surface"]
        ]
        glass = data["sensor"].get("cover_glass")
        cover_glass = {} if glass is None else {"cover_glass": CoverGlass.model_construct(**glass)}
        lens = Lens.model_construct(
            wavelengths_um=tuple(data["wavelengths_um"]),
            object=ObjectSpace.model_construct(**data["object"]),
            sensor=Sensor.model_construct(**data["sensor"] | cover_glass),
            surfaces=tuple(surfaces),
            edges=tuple(edges),
        )
        return list(implausible_lengths(lens))[:MOST_FAULTS]
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError):
        return []  # the tables have another fault, which the caller reports


def _file_sources(part: Surface | CoverGlass) -> dict[str, SurfaceFigureSource | Coating]:
    """Return the sources of a part, by their keys, that are files."""
    sources = {name: getattr(part, name, None) for name in ("figure", "coating")}
    return {
        name: source
        for name, source in sources.items()
        if isinstance(source, SurfaceFigureSource | Coating) and source.file is not None
    }


def _with_resolved_files(part: Part, path: Path, location: str) -> Part:
    """Return a part with absolute paths of its files, which must not lead out of the design's folder."""
    changes = {}
    for name, source in _file_sources(part).items():
        assert source.file is not None
        file = (path.parent / source.file).resolve()
        validate_inside(file, path, f"{location}, {name}, file", DesignError)
        changes[name] = source.model_copy(update={"file": file})
    return part.model_copy(update=changes) if changes else part


def _write_relative_files(part: Surface | CoverGlass, table: dict[str, Any], folder: Path) -> None:
    """Replace the paths of a part's files in its table by those relative to a folder."""
    for name, source in _file_sources(part).items():
        assert source.file is not None
        table[name]["file"] = os.path.relpath(source.file, folder.resolve())


def save_design(lens: Lens, path: str | os.PathLike[str]) -> None:
    """Write a lens to a design file; :func:`load_design` reads an equal lens from it.

    Glass catalogues and measured figures are not copied; the file holds their paths relative to its folder.

    Parameters
    ----------
    lens
        The lens.
    path
        File to write.

    Raises
    ------
    InputError
        If the file cannot be written. An existing file then stays unchanged.

    Examples
    --------
    >>> from lensdesign import load_design, save_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> thicker = lens.with_surface(0, thickness_mm=10.0)
    >>> save_design(thicker, "thicker.toml")
    >>> load_design("thicker.toml") == thicker
    True
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(design_text(lens, path.parent), encoding="utf-8")


def design_text(lens: Lens, folder: Path = Path()) -> str:
    """Return a lens as the text of a design file.

    Parameters
    ----------
    lens
        The lens.
    folder
        Folder of the design file; paths in the text are relative to it (default: the current folder).
    """
    data = lens.model_dump(mode="json", by_alias=True, exclude_defaults=True, exclude_none=True)
    if lens.glass_catalogs:
        data["glass_catalogs"] = [os.path.relpath(c, folder.resolve()) for c in lens.glass_catalogs]
    data["surface"][lens.stop_index]["stop"] = True  # in memory, the stop may be implicit
    for surface, table in zip(lens.surfaces, data["surface"], strict=True):
        _write_relative_files(surface, table, folder)
    if lens.sensor.cover_glass is not None:
        _write_relative_files(lens.sensor.cover_glass, data["sensor"]["cover_glass"], folder)
    return tomli_w.dumps(data)
