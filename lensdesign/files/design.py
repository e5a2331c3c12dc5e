"""Design files (TOML): read with every fault named, written without loss."""

from __future__ import annotations

import os
from pathlib import Path

import tomli_w

from lensdesign.common.input_files import refuse_outside
from lensdesign.common.toml_files import read_toml, validate
from lensdesign.errors import DesignError, InputError, atomic_path
from lensdesign.files.figures import check_figures
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface import Surface


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
    """
    path = Path(path)
    data = read_toml(path)
    lens = validate(Lens, data, path)
    catalogs = tuple((path.parent / c).resolve() for c in lens.glass_catalogs)
    surfaces = tuple(_with_resolved_figure(surface, path.parent) for surface in lens.surfaces)
    for catalog in catalogs:
        refuse_outside(catalog, path, "glass_catalogs", DesignError)
    for number, surface in enumerate(surfaces, start=1):
        if surface.figure is not None and surface.figure.file is not None:
            refuse_outside(surface.figure.file, path, f"surface {number}, figure, file", DesignError)
    lens = lens.model_copy(update={"glass_catalogs": catalogs, "surfaces": surfaces})
    try:
        check_figures(lens)
        for wavelength in lens.wavelengths_um:
            lens.indices(wavelength)
    except InputError as error:
        raise type(error)(f"{path}: {error}") from error
    return lens


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
    for surface, table in zip(lens.surfaces, data["surface"], strict=True):
        if surface.figure is not None and surface.figure.file is not None:
            table["figure"]["file"] = os.path.relpath(surface.figure.file, folder.resolve())
    return tomli_w.dumps(data)
