"""A tolerance study for a lens at another size.

With scaled tolerances, each perturbed lens of the new size is the scaled copy of a perturbed original lens.
Spread angles and footprints, relative to the lens, are then the same, and so are their yields. Wavelengths do
not scale. Wavefront errors in waves scale with the lens, so yields of wavefronts, contrasts and correlations
differ.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.shapes.base import length_power
from tolerancing.perturbations.parameters import PerturbedParameter
from tolerancing.study.files import check_against, save_study, study_from_tables
from tolerancing.study.study import Study

VALUES = ("mean", "sigma", "limit", "half_width", "values", "picture_values")
"""Keys of perturbations, compensators and series with values in the unit of the parameter."""

FIXED_LENGTHS = ("patch_mm", "region_mm")
"""Lengths of merits that do not scale: parts of the object that contain a number of resolution elements."""

LENGTH_LIMITS = ("footprint_radius_mm", "image_shift_um")
"""Kinds of merits whose limits are lengths of the lens, not of the light."""


def scaling_of(parameter: PerturbedParameter) -> int:
    """Return the power of the scale factor by which deviations of a parameter are multiplied.

    ======================  =====  ====================================================================
    unit of the parameter   power  reason
    ======================  =====  ====================================================================
    mm                      1      lengths scale: radii, thicknesses, decenters, runouts, distances
    fringes, waves          1      they count a sag, which is a length, in a wavelength that stays
    deg                     0      angles of similar lenses are equal
    percent                 0      ratios are equal: of radii, of Abbe numbers
    c                       0      expansion is a ratio of lengths
    um                      0      the light, and with it its wavelength, stays
    nm                      0      a roughness scatters as much light of the same wavelength
    none: conic, index      0      pure numbers of the shape and the glass
    none: (odd_)asphere_n   1 - n  the coefficient of r^n multiplies a length to the n to give a length
    none: slices            0      a number
    ======================  =====  ====================================================================
    """
    if parameter.unit:
        return int(parameter.unit in ("mm", "fringes", "waves"))
    return length_power(parameter.parameter)


def study_of_scaled_lens(study: Study, factor: float, design: str) -> Study:
    """Return the study of a scaled lens with the scaled tolerances of a study.

    Parameters
    ----------
    study
        Study of the lens.
    factor
        Factor by which :func:`lensdesign.scaled` multiplied all lengths of the lens.
    design
        Path of the scaled design, relative to the folder of the new study.

    Returns
    -------
    Study
        The study with scaled perturbations, compensators, series and pivot (:func:`scaling_of`). Field
        points, planes and limits of footprints and image shifts scale, too. Line widths, patches, limits of
        waves, contrasts and correlations, noise and numbers of samples do not.

    Raises
    ------
    InputError
        If a deviation that scales is measured in a file, or a scaled value is not allowed.

    Examples
    --------
    >>> from tolerancing import load_study
    >>> study = load_study("designs/as_built_tolerances.toml").study
    >>> twin = study_of_scaled_lens(study, 0.1, "twin.toml")
    >>> study.perturbations[0].column, study.perturbations[0].tolerance, twin.perturbations[0].tolerance
    ('lens_decenter_x_mm', 0.1, 0.01)
    """

    def lengths(table: Any, key: str = "") -> Any:
        """Return a table with all values scaled whose keys end in mm."""
        if isinstance(table, Mapping):
            return {name: lengths(value, name) for name, value in table.items()}
        if isinstance(table, list):
            return [lengths(value, key) for value in table]
        is_length = key.endswith("_mm") and key not in FIXED_LENGTHS and isinstance(table, int | float)
        return factor * table if is_length and not isinstance(table, bool) else table

    def deviations(table: dict[str, Any], parameter: PerturbedParameter) -> dict[str, Any]:
        """Return a table of a perturbed parameter with its values and its seat scaled."""
        by = factor ** scaling_of(parameter)
        if "file" in table and by != 1.0:
            raise InputError(
                f"{parameter.column}: its deviations are measured in {table['file']}, which is not scaled; "
                "give a distribution without a file"
            )
        scaled = {key: _times(value, by) if key in VALUES else value for key, value in table.items()}
        if isinstance(table.get("seat"), int | float):
            scaled["seat"] = factor * table["seat"]
        return scaled

    tables = study.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_unset=True)
    complete = study.model_dump(mode="json", by_alias=True, exclude_none=True)
    # Lengths with a default scale as well; a field point that is not given is on the axis.
    merits = [
        {k: v for k, v in whole.items() if k.endswith("_mm") and v and not k.startswith("field_")} | given
        for given, whole in zip(tables["merit"], complete["merit"], strict=True)
    ]
    tables |= lengths({key: complete[key] for key in ("pivot_z_mm", "sampling")} | {"merit": merits})
    for merit in tables["merit"]:
        if merit["kind"] in LENGTH_LIMITS:
            merit |= {key: factor * merit[key] for key in ("at_least", "at_most") if key in merit}
    tables["perturbation"] = [
        deviations({**table, **table.pop("distribution"), "distribution": own.distribution.kind}, own)
        for table, own in zip(tables["perturbation"], study.perturbations, strict=True)
    ]
    for key, parameters in (("compensator", study.compensators), ("sweep", study.sweeps)):
        found = zip(tables.get(key, []), parameters, strict=True)
        tables[key] = [lengths(deviations(table, own)) for table, own in found]
    for table, grid in zip(tables.get("grid", []), study.grids, strict=True):
        table |= lengths({k: v for k, v in table.items() if k not in ("x", "y")})
        table |= {"x": deviations(table["x"], grid.x), "y": deviations(table["y"], grid.y)}
    tables["slice_count"] = lengths(tables.get("slice_count", []))
    tables |= {"design": design, "title": f"{study.title}, scaled by {factor:g}".lstrip(", ")}
    return study_from_tables({k: v for k, v in tables.items() if v != []}, "scaled study")


def _times(value: Any, by: float) -> Any:
    return [by * one for one in value] if isinstance(value, list) else by * value


def write_scaled_study(study: Study, folder: Path, factor: float, twin: Lens, design: Path) -> Path:
    """Write the study of a scaled lens beside its design, and return its path.

    Parameters
    ----------
    study, folder
        Study of the lens, and the folder of its file.
    factor
        Factor by which the lens is scaled.
    twin, design
        The scaled lens, and its design file. The study of `twin.toml` is `twin_tolerances.toml`.

    Raises
    ------
    InputError
        As for :func:`study_of_scaled_lens`; also if the study names files and the new one would be in another
        folder, if the scaled lens is too small for a patch, or if the file cannot be written.
    """
    path = design.with_name(f"{design.stem}_tolerances.toml")
    named = [one.file_name for one in study.perturbations if one.file_name]
    named += [one.file_name for one in study.all_merits if one.file_name]
    if named and path.resolve().parent != folder.resolve():
        raise InputError(
            f"{path}: the study names {named[0]} relative to {folder}; write the scaled design to that folder"
        )
    scaled = study_of_scaled_lens(study, factor, design.name)
    check_against(scaled, twin, str(path))
    save_study(scaled, path)
    return path
