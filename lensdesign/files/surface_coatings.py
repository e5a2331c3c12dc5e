"""Coatings of a design's surfaces, and tables of measured amplitudes.

A table is CSV text whose first line names the columns `wavelength_um`, `incidence_deg`, `ts_amplitude`,
`ts_phase_deg`, `tp_amplitude` and `tp_phase_deg`, and optionally `rs_amplitude`, `rs_phase_deg`,
`rp_amplitude` and `rp_phase_deg`. It has a row for every combination of its wavelengths and its angles of
incidence, which begin at 0. The angle is that in the medium in front of the surface.

The square of an amplitude is the fraction of the flux. A phase is positive where the coating delays the
light, relative to an infinitely thin coating on the surface.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.tables import read_number, read_table
from lensdesign.errors import InputError
from lensdesign.lens.coatings.coating import Coating, SurfaceCoating, quarter_wave_mgf2
from lensdesign.lens.coatings.compiled import CompiledCoating, FilmCoating, IdealCoating, TableCoating
from lensdesign.lens.coatings.measured import CoatingTable
from lensdesign.lens.glass import is_gap
from lensdesign.lens.lens import Lens


def coating_table(path: Path) -> CoatingTable:
    """Read a table of measured amplitudes; a table that did not change is read once.

    Raises
    ------
    InputError
        If the file cannot be read, has other columns, misses combinations of wavelength and angle, or states
        values that no surface can have. The message names file and line.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}") from error
    return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=16)
def _read(path: Path, _mtime_ns: int, _size: int) -> CoatingTable:
    table = read_table(path)
    has_reflection = any(name.startswith(("rs", "rp")) for name in table.names)
    kinds = ("ts", "tp", "rs", "rp") if has_reflection else ("ts", "tp")
    values_of = [f"{kind}_{part}" for kind in kinds for part in ("amplitude", "phase_deg")]
    columns = ["wavelength_um", "incidence_deg", *values_of]
    unknown = [name for name in table.names if name not in columns]
    if unknown:
        raise InputError(f"{path}: unknown column {unknown[0]!r}; allowed: {', '.join(columns)}")
    numbers: dict[str, Array] = {}
    for name in columns:
        cells = table.column(name)
        values = [read_number(text, location, name) for text, location in cells]
        for value, (_, location) in zip(values, cells, strict=True):
            _check_value(value, name, location)
        numbers[name] = np.array(values)
    if not table.rows:
        raise InputError(f"{path}: holds no values")
    wavelengths, incidences = (np.unique(numbers[name]) for name in columns[:2])
    shape = len(wavelengths), len(incidences)
    row = np.searchsorted(wavelengths, numbers["wavelength_um"])
    column = np.searchsorted(incidences, numbers["incidence_deg"])
    count = np.zeros(shape, int)
    np.add.at(count, (row, column), 1)
    for i, j in np.argwhere(count != 1):
        raise InputError(
            f"{path}: {count[i, j] or 'no'} rows at {wavelengths[i]:g} µm and {incidences[j]:g} deg; every "
            "combination of wavelength and angle needs one"
        )
    if incidences[0] != 0.0:
        raise InputError(f"{path}: the angles of incidence begin at {incidences[0]:g} deg: must begin at 0")

    def grid(name: str) -> Array:
        values = np.empty(shape)
        values[row, column] = numbers[name]
        return values

    amplitudes = np.stack([grid(f"{kind}_amplitude") for kind in kinds])
    phases = np.unwrap(np.radians(np.stack([grid(f"{kind}_phase_deg") for kind in kinds])), axis=-1)
    phases = np.unwrap(phases, axis=1)
    _check_physics(path, wavelengths, incidences, amplitudes, phases)
    return CoatingTable(path, wavelengths, incidences, amplitudes, phases)


def _check_value(value: float, name: str, location: str) -> None:
    limits = {"wavelength_um": (1e-3, 1e3), "incidence_deg": (0.0, 90.0), "amplitude": (0.0, 1.0)}
    low, high = next((ends for key, ends in limits.items() if name.endswith(key)), (-1e6, 1e6))
    if not low <= value <= high:
        raise InputError(f"{location}: {name} = {value:g}: must be from {low:g} to {high:g}")


def _check_physics(
    path: Path, wavelengths: Array, incidences: Array, amplitudes: Array, phases_rad: Array
) -> None:
    """Check that both polarizations agree at normal incidence, and that no light is created."""
    tolerance = 1e-3
    values = amplitudes * np.exp(1j * phases_rad)
    different = np.abs(values[0, :, 0] - values[1, :, 0]) > tolerance
    if np.any(different):
        raise InputError(
            f"{path}: ts and tp differ at {wavelengths[np.argmax(different)]:g} µm and 0 deg: must be equal "
            "at normal incidence"
        )
    if len(amplitudes) == 2:
        return
    total = amplitudes[:2] ** 2 + amplitudes[2:] ** 2
    for kind, i, j in np.argwhere(total > 1.0 + tolerance):
        raise InputError(
            f"{path}: transmittance and reflectance of {'sp'[kind]} light at {wavelengths[i]:g} µm and "
            f"{incidences[j]:g} deg add up to {total[kind, i, j]:.4g}: must be at most 1"
        )


def compile_coatings(lens: Lens, wavelength_um: float) -> tuple[CompiledCoating, ...]:
    """Return the coating of every surface of a lens at a wavelength.

    Raises
    ------
    MaterialError
        If the index of a film is not known at the wavelength.
    InputError
        If a table cannot be read, or does not contain the wavelength.
    """
    media = [None, *(surface.material for surface in lens.surfaces)]
    compiled = []
    for number, surface in enumerate(lens.surfaces, start=1):
        in_air = tuple(is_gap(medium) for medium in media[number - 1 : number + 1])
        try:
            compiled.append(_compiled(surface.coating, in_air, lens.wavelengths_um[0], wavelength_um))
        except InputError as error:
            raise type(error)(f"surface {number}, coating: {error}") from error
    return tuple(compiled)


def check_cover_glass_coating(lens: Lens, wavelength_um: float) -> None:
    """Check that the coating of the cover glass is known at a wavelength.

    Raises
    ------
    InputError
        If it is not; the message names the cover glass.
    """
    glass = lens.sensor.cover_glass
    if glass is None:
        return
    try:
        _compiled(glass.coating, (True, False), lens.wavelengths_um[0], wavelength_um)
    except InputError as error:
        raise type(error)(f"cover glass, coating: {error}") from error


def _compiled(
    coating: SurfaceCoating, in_air: tuple[bool, ...], design_wavelength_um: float, wavelength_um: float
) -> CompiledCoating:
    if coating == "ideal":
        return IdealCoating()
    if coating == "bare":
        return FilmCoating((), (), wavelength_um)
    own = quarter_wave_mgf2(design_wavelength_um) if coating == "mgf2" else coating
    assert isinstance(own, Coating)
    if own.file is not None:
        table = coating_table(own.file)
        table.coefficients(wavelength_um, 1.0)  # raises if the table lacks the wavelength
        return TableCoating(table, wavelength_um)
    lies_behind = not in_air[0] and in_air[1]
    layers = own.layers[::-1] if lies_behind else own.layers
    return FilmCoating(
        tuple(layer.complex_index(wavelength_um) for layer in layers),
        tuple(layer.thickness_um(own.design_wavelength_um or wavelength_um) for layer in layers),
        wavelength_um,
        lies_behind,
    )
