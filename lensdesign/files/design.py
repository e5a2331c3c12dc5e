"""Design files (TOML): read with every fault named, written without loss."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from lensdesign.common.input_files import validate_inside
from lensdesign.common.toml_files import MOST_FAULTS, joined_faults, read_toml, validate
from lensdesign.errors import DesignError, InputError, atomic_path
from lensdesign.files.figures import check_figures
from lensdesign.lens.edges import Edge, Flange
from lensdesign.lens.lengths import LongRadiusWarning, doubted_lengths, long_radii
from lensdesign.lens.lens import Lens, ObjectSpace, Sensor
from lensdesign.lens.surface import Surface

OfLens = TypeVar("OfLens", bound=Lens)


def load_design(path: str | os.PathLike[str]) -> Lens:
    """Read a lens from a design file.

    Parameters
    ----------
    path
        A TOML file. Paths of glass catalogues and measured figures in it are relative to its own folder, and
        lead to nothing outside it but within :func:`lensdesign.common.input_files.files_from`.

    Returns
    -------
    Lens

    Raises
    ------
    DesignError
        If the file cannot be read or does not describe a lens; the message names file, key, value and
        what is allowed.
    InputError
        If a measured figure cannot be read, or does not cover its surface's clear aperture.
    MaterialError
        If a glass is unknown, or not known at one of the wavelengths.

    Warns
    -----
    LongRadiusWarning
        If a radius is that of a weak surface, and a thousandth of it would be usual.
    """
    path = Path(path)
    return lens_of(read_toml(path), path)


def lens_of(data: dict[str, Any], path: Path) -> Lens:
    """A lens from the tables of a design file, refused as :func:`load_design` refuses it.

    Parameters
    ----------
    data
        The tables.
    path
        Their file, whether it has been written or not: paths in them start from its folder, and messages
        name it.
    """
    validate_kind(data, path, "design")
    lens = validated_lens(Lens, data, path)
    catalogs = tuple((path.parent / c).resolve() for c in lens.glass_catalogs)
    surfaces = tuple(_with_resolved_figure(surface, path.parent) for surface in lens.surfaces)
    for catalog in catalogs:
        validate_inside(catalog, path, "glass_catalogs", DesignError)
    for number, surface in enumerate(surfaces, start=1):
        if surface.figure is not None and surface.figure.file is not None:
            validate_inside(surface.figure.file, path, f"surface {number}, figure, file", DesignError)
    lens = lens.model_copy(update={"glass_catalogs": catalogs, "surfaces": surfaces})
    try:
        check_figures(lens)
        for wavelength in lens.wavelengths_um:
            lens.indices(wavelength)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    return lens


def validate_kind(data: Mapping[str, object], path: Path, wanted: str) -> None:
    """Refuse a file of another kind, with the command that takes it.

    Parameters
    ----------
    data
        The file's tables.
    path
        The file.
    wanted
        ``design`` or ``specification``.

    Raises
    ------
    DesignError
    """
    kind = _kind(data)
    if kind in ("", wanted):
        return
    takes, needs = TAKEN_BY[kind], LACKS[wanted]
    raise DesignError(f"{path}: this is a {kind}, which {takes} takes; a {wanted} is needed here{needs}")


TAKEN_BY = {
    "design": "lensdesign check (or draw, or export)",
    "specification": "lensdesign optimize",
    "tolerance study": "tolerancing run",
}
"""What takes each kind of file."""

LACKS = {
    "design": ": what lensdesign optimize writes, say",
    "specification": ": a design with a [[variable]] for each thing that may change",
}


def _kind(data: Mapping[str, object]) -> str:
    """What a file is, by its tables; empty where they do not say."""
    if "design" in data and {"trials", "merit", "perturbation"} & data.keys():
        return "tolerance study"
    if {"optimize", "constraints", "variable"} & data.keys():
        return "specification"
    return "design" if {"surface", "object", "sensor"} <= data.keys() else ""


def validated_lens(model: type[OfLens], data: dict[str, Any], path: Path) -> OfLens:
    """A lens or a specification from its tables, with a stop and with lengths that go together.

    A length in another unit often breaks a rule of geometry, too: surfaces cross, or end within their
    aperture. The message then names the length first.

    Raises
    ------
    DesignError
        If the tables are not valid, no surface is marked as the stop, or a length seems to be given in
        another unit.

    Warns
    -----
    LongRadiusWarning
        If a radius is that of a weak surface, and a thousandth of it would be usual.
    """
    try:
        lens = validate(model, data, path)
    except DesignError as error:
        doubts = [f"{path}: {doubt}" for doubt in _doubts_of_tables(data)]
        raise DesignError("\n".join([*doubts, str(error)])) from None
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
    """Refuse a lens with lengths that no lens has and that another unit would explain.

    Raises
    ------
    DesignError
        Naming the source and each length, with the value that may be meant.
    """
    doubts = [f"{source}: {doubt}" for doubt in doubted_lengths(lens)]
    if doubts:
        raise DesignError(joined_faults(doubts))


def _doubts_of_tables(data: Mapping[str, Any]) -> list[str]:
    """Sentences that question lengths of tables that are no valid lens; none where they cannot be read."""
    try:
        edges = [
            Edge.model_construct(
                **edge | {"flange": Flange.model_construct(**edge["flange"]) if "flange" in edge else None}
            )
            for edge in data.get("edge", ())
        ]
        surfaces = [
            Surface.model_construct(**{key: table[key] for key in table if key != "figure"})
            for table in data["surface"]
        ]
        lens = Lens.model_construct(
            wavelengths_um=tuple(data["wavelengths_um"]),
            object=ObjectSpace.model_construct(**data["object"]),
            sensor=Sensor.model_construct(**data["sensor"]),
            surfaces=tuple(surfaces),
            edges=tuple(edges),
        )
        return list(doubted_lengths(lens))[:MOST_FAULTS]
    except (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError):
        return []  # the fault that is reported anyway is of another kind


def _with_resolved_figure(surface: Surface, folder: Path) -> Surface:
    """A surface whose figure's file, if it has one, is known from anywhere."""
    if surface.figure is None or surface.figure.file is None:
        return surface
    figure = surface.figure.model_copy(update={"file": (folder / surface.figure.file).resolve()})
    return surface.model_copy(update={"figure": figure})


def save_design(lens: Lens, path: str | os.PathLike[str]) -> None:
    """Write a lens to a design file; reading it back gives an equal lens.

    Glass catalogues and measured figures stay where they are; the file holds the way to them from its folder.

    Raises
    ------
    InputError
        If the file cannot be written; whatever stood there stays.
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        temporary.write_text(design_text(lens, path.parent), encoding="utf-8")


def design_text(lens: Lens, folder: Path = Path()) -> str:
    """A lens as the text of a design file in `folder`."""
    data = lens.model_dump(mode="json", by_alias=True, exclude_defaults=True, exclude_none=True)
    if lens.glass_catalogs:
        data["glass_catalogs"] = [os.path.relpath(c, folder.resolve()) for c in lens.glass_catalogs]
    data["surface"][lens.stop_index]["stop"] = True  # in memory it may go without saying
    for surface, table in zip(lens.surfaces, data["surface"], strict=True):
        if surface.figure is not None and surface.figure.file is not None:
            table["figure"]["file"] = os.path.relpath(surface.figure.file, folder.resolve())
    return tomli_w.dumps(data)
