"""Glasses by name or by catalogue, as choices of a specification."""

from __future__ import annotations

from lensdesign.errors import InputError
from lensdesign.lens.glass import list_glasses
from lensdesign.optimization.specification.specification import Specification, validate_known
from lensdesign.optimization.specification.variables import VariableRange

CATALOGUE = "catalogue:"


def with_glasses(specification: Specification, text: str) -> Specification:
    """The specification with other choices for the glass of its first element.

    Parameters
    ----------
    specification
    text
        Names with commas between them, or ``catalogue:`` and the catalogue's name.

    Raises
    ------
    InputError
        If no glass is named, there is no such catalogue, or of none of its glasses
        enough is known.
    MaterialError
        If too little is known of a glass that is named.
    """
    first = specification.glass_fronts[0] + 1
    if text.startswith(CATALOGUE):
        names = _of_catalogue(specification, first, text.removeprefix(CATALOGUE))
    else:
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        for name in names:
            validate_known(specification, first, name)
    if not names:
        raise InputError(f"--glasses {text}: names no glass")
    kept = tuple(v for v in specification.variables if not (v.parameter == "material" and v.surface == first))
    chosen = VariableRange(parameter="material", surface=first, choices=names)
    return specification.model_copy(update={"variables": (*kept, chosen)})


def _of_catalogue(specification: Specification, surface: int, name: str) -> tuple[str, ...]:
    """Glasses of a catalogue of which enough is known."""
    known = list_glasses(specification.glass_catalogs)
    names = sorted({glass for glass, catalogue in known if catalogue.casefold() == name.casefold()})
    if not names:
        allowed = ", ".join(sorted({catalogue for _, catalogue in known}))
        raise InputError(f"--glasses {CATALOGUE}{name}: there is no such catalogue; allowed: {allowed}")
    found = []
    for glass in names:
        try:
            validate_known(specification, surface, glass)
        except InputError:
            continue
        found.append(glass)
    return tuple(found)
