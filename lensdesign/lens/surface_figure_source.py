"""The source of a surface's measured figure, as a design file states it."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from pydantic import field_serializer, field_validator, model_validator

from lensdesign.common.frozen_model import Finite, FrozenModel, Positive, as_path
from lensdesign.lens.zernikes import zernike_orders

TEST_WAVELENGTH_UM = 0.6328
"""Wavelength of the helium-neon laser of surface tests, the unit of "waves at 633 nm"."""


class SurfaceFigureSource(FrozenModel):
    """The source of a surface's measured figure (sag error, positive along +z).

    Exactly one of `file`, `zernike_um` and `zernike_waves_633nm` is given.

    Attributes
    ----------
    file
        Path of a grid file; see :mod:`lensdesign.files.surface_figures`.
    zernike_um, zernike_waves_633nm
        Coefficients of Zernike polynomials by OSA/ANSI index, given as a mapping and kept as pairs. Each
        coefficient is the root mean square sag error of its polynomial, in um or in waves of 632.8 nm; see
        :mod:`lensdesign.lens.zernikes`.
    semi_diameter_mm
        Semi-diameter of the disc over which the Zernike polynomials are normalized; None with a grid file.

    Examples
    --------
    >>> from lensdesign import SurfaceFigureSource
    >>> source = SurfaceFigureSource(zernike_um={4: 0.1, 12: -0.02}, semi_diameter_mm=5.0)
    >>> source.coefficients_um
    {4: 0.1, 12: -0.02}
    """

    file: Path | None = None
    zernike_um: tuple[tuple[int, Finite], ...] = ()
    zernike_waves_633nm: tuple[tuple[int, Finite], ...] = ()
    semi_diameter_mm: Positive | None = None

    @field_validator("file", mode="before")
    @classmethod
    def _file(cls, value: Any) -> Any:
        return as_path(value)

    @field_validator("zernike_um", "zernike_waves_633nm", mode="before")
    @classmethod
    def _coefficients(cls, value: Any) -> Any:
        """Return the pairs of a table or of a sequence of pairs, in increasing order of the index."""
        if not isinstance(value, dict | tuple):
            raise ValueError("must be a table: { index = coefficient, ... }")
        pairs = {}
        for key, number in value.items() if isinstance(value, dict) else value:
            index = int(key) if isinstance(key, str) and key.isdecimal() else key
            zernike_orders(index)
            if (
                isinstance(number, bool)
                or not isinstance(number, int | float)
                or not abs(number) <= sys.float_info.max
            ):
                raise ValueError(f"coefficient {index} = {number!r:.60}: must be a finite number")
            pairs[index] = float(number)
        return tuple(sorted(pairs.items()))

    @field_serializer("zernike_um", "zernike_waves_633nm")
    def _table(self, value: tuple[tuple[int, float], ...]) -> dict[str, float]:
        return {str(index): number for index, number in value}

    @model_validator(mode="after")
    def _one_source(self) -> SurfaceFigureSource:
        sources = ("file", "zernike_um", "zernike_waves_633nm")
        given = [name for name in sources if getattr(self, name)]
        if len(given) != 1:
            raise ValueError(f"{' and '.join(given) or 'nothing'} given: must be one of {', '.join(sources)}")
        if (self.file is None) != (self.semi_diameter_mm is not None):
            raise ValueError(
                f"{given[0]} needs a semi_diameter_mm, over which the polynomials are normalized"
                if self.file is None
                else "semi_diameter_mm goes with Zernike coefficients; a grid file states its own size, "
                "leave it out"
            )
        return self

    @property
    def coefficients_um(self) -> dict[int, float]:
        """Zernike coefficients by OSA/ANSI index; empty for a grid file."""
        waves = {index: TEST_WAVELENGTH_UM * value for index, value in self.zernike_waves_633nm}
        return waves | dict(self.zernike_um)
