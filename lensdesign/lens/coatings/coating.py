"""The coating of a surface, as a design file states it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from lensdesign.common.frozen_model import FrozenModel, Positive, as_path
from lensdesign.lens.coatings.film_materials import film_index, film_table

CoatingName = Literal["ideal", "bare", "mgf2"]
"""Coatings with a name: all light is transmitted; no coating; a quarter wave of magnesium fluoride."""

MOST_LAYERS = 200


class CoatingLayer(FrozenModel):
    """A film of a coating.

    Attributes
    ----------
    material
        Film material: a name of :data:`lensdesign.lens.coatings.film_materials.FILM_PAGES`, or a page of
        refractiveindex.info with absorption data (``shelf/book/page``).
    index, extinction
        Constant index and extinction coefficient, instead of a material.
    thickness_nm
        Thickness.
    quarter_waves
        Optical thickness in quarters of the coating's design wavelength, instead of `thickness_nm`.

    Examples
    --------
    >>> from lensdesign import CoatingLayer
    >>> round(CoatingLayer(material="MgF2", quarter_waves=1.0).thickness_um(0.55), 4)
    0.0994
    """

    material: str | None = None
    index: Annotated[float, Field(ge=1.0, le=10.0, allow_inf_nan=False)] | None = None
    extinction: Annotated[float, Field(ge=0.0, le=20.0, allow_inf_nan=False)] = 0.0
    thickness_nm: Annotated[Positive, Field(le=1e5)] | None = None
    quarter_waves: Annotated[Positive, Field(le=1e3)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> CoatingLayer:
        if (self.material is None) == (self.index is None):
            raise ValueError(
                f"{'material and index' if self.index is not None else 'nothing'} given: a layer has either "
                "a material or an index"
            )
        if self.material is not None and self.extinction:
            raise ValueError(f"extinction = {self.extinction:g}: belongs to an index, not to a material")
        if (self.thickness_nm is None) == (self.quarter_waves is None):
            given = "thickness_nm and quarter_waves" if self.thickness_nm is not None else "no thickness"
            raise ValueError(f"{given} given: a layer has either thickness_nm or quarter_waves")
        if self.material is not None:
            film_table(self.material)  # raises if it is unknown
        return self

    def complex_index(self, wavelength_um: float) -> complex:
        """Return n + i k at a vacuum wavelength; see :func:`film_index` for errors."""
        if self.material is not None:
            return film_index(self.material, wavelength_um)
        assert self.index is not None
        return complex(self.index, self.extinction)

    def thickness_um(self, design_wavelength_um: float) -> float:
        """Return the thickness, for quarter waves at a design wavelength."""
        if self.thickness_nm is not None:
            return 1e-3 * self.thickness_nm
        assert self.quarter_waves is not None
        index = self.complex_index(design_wavelength_um).real
        return 0.25 * self.quarter_waves * design_wavelength_um / index


class Coating(FrozenModel):
    """A coating that is given by its layers, or by a table of its measured amplitudes.

    Attributes
    ----------
    layers
        Films from the air to the glass, on either side of an element. Between two glasses, or between air and
        air, from the front to the back.
    design_wavelength_um
        Vacuum wavelength of `quarter_waves`.
    file
        Path of a table of measured amplitudes (see :mod:`lensdesign.files.surface_coatings`), instead of
        layers.

    Examples
    --------
    >>> from lensdesign import Coating, CoatingLayer
    >>> coating = Coating(
    ...     layers=(CoatingLayer(material="MgF2", quarter_waves=1.0),), design_wavelength_um=0.55
    ... )
    >>> len(coating.layers)
    1
    """

    layers: Annotated[tuple[CoatingLayer, ...], Field(max_length=MOST_LAYERS)] = ()
    design_wavelength_um: Positive | None = None
    file: Path | None = None

    @field_validator("file", mode="before")
    @classmethod
    def _file(cls, value: Any) -> Any:
        return as_path(value)

    @model_validator(mode="after")
    def _one_source(self) -> Coating:
        if bool(self.layers) == (self.file is not None):
            given = "layers and file" if self.layers else "nothing"
            raise ValueError(f'{given} given: must be one of layers and file (or "bare" without a coating)')
        uses_waves = any(layer.quarter_waves is not None for layer in self.layers)
        if uses_waves != (self.design_wavelength_um is not None):
            raise ValueError(
                "quarter_waves need a design_wavelength_um"
                if uses_waves
                else "design_wavelength_um belongs to layers in quarter_waves; omit it"
            )
        return self

    @property
    def text(self) -> str:
        """The coating in a few words, such as `MgF2, quarter wave at 550 nm`."""
        if self.file is not None:
            return f"table {self.file.name}"
        wavelength = self.design_wavelength_um
        at = "" if wavelength is None else f"{1e3 * wavelength:.6g} nm"
        if len(self.layers) > 1:
            return f"{len(self.layers)} layers" + (at and f", {at}")
        (layer,) = self.layers
        film = layer.material or f"n = {layer.index:g}"
        if layer.thickness_nm is not None:
            return f"{film}, {layer.thickness_nm:g} nm"
        count = layer.quarter_waves
        return f"{film}, {'quarter wave' if count == 1.0 else f'{count:g} quarter waves'} at {at}"


def _kind(value: Any) -> str:
    return "branch-table" if isinstance(value, dict | Coating) else "branch-name"


SurfaceCoating = Annotated[
    Annotated[CoatingName, Tag("branch-name")] | Annotated[Coating, Tag("branch-table")],
    Discriminator(_kind),
]
"""Value of a surface's `coating`: a name or a table."""


NO_FILMS = (
    'the coating of this surface has no films whose thickness could change; set coating = "mgf2" or layers'
)
"""Message for a surface without films whose thickness is to change."""


def has_films(coating: SurfaceCoating) -> bool:
    """Return whether a coating consists of films: ``mgf2`` or layers."""
    return coating == "mgf2" if isinstance(coating, str) else bool(coating.layers)


@lru_cache(maxsize=64)
def quarter_wave_mgf2(design_wavelength_um: float) -> Coating:
    """Return the coating ``mgf2``: a quarter wave of magnesium fluoride at a wavelength."""
    layer = CoatingLayer(material="MgF2", quarter_waves=1.0)
    return Coating(layers=(layer,), design_wavelength_um=design_wavelength_um)


def coating_text(coating: SurfaceCoating, design_wavelength_um: float) -> str:
    """Return a surface's coating in a few words: its name, material and thickness, or number of layers.

    Parameters
    ----------
    coating
        Coating of the surface.
    design_wavelength_um
        First wavelength of the design, at which ``mgf2`` is a quarter wave.
    """
    if coating == "mgf2":
        return quarter_wave_mgf2(design_wavelength_um).text
    return coating if isinstance(coating, str) else coating.text
