"""Choice of glasses for a specification, by name or by catalogue."""

from __future__ import annotations

from lensdesign.errors import InputError
from lensdesign.lens.glass import list_glasses
from lensdesign.optimization.specification.specification import Specification, validate_known
from lensdesign.optimization.specification.variables import VariableRange

CATALOGUE = "catalogue:"


def with_glasses(specification: Specification, text: str) -> Specification:
    """Return the specification with other choices for the glass of its first element.

    Parameters
    ----------
    specification
        The specification.
    text
        Names separated by commas, or ``catalogue:`` followed by the name of a catalogue.

    Raises
    ------
    InputError
        If the text names no glass, the catalogue does not exist, or none of its glasses has the required
        data.
    MaterialError
        If a named glass lacks data that the specification requires.
    """
    first = specification.glass_fronts[0] + 1
    if text.startswith(CATALOGUE):
        names = _catalogue_glasses(specification, first, text.removeprefix(CATALOGUE))
    else:
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        for name in names:
            validate_known(specification, first, name)
        if not names:
            raise InputError(f"--glasses {text}: names no glass")
    kept = tuple(v for v in specification.variables if not (v.parameter == "material" and v.surface == first))
    chosen = VariableRange(parameter="material", surface=first, choices=names)
    return specification.model_copy(update={"variables": (*kept, chosen)})


def _catalogue_glasses(specification: Specification, surface: int, name: str) -> tuple[str, ...]:
    """Return the glasses of a catalogue that have all data required by the specification."""
    known = list_glasses(specification.glass_catalogs)
    names = sorted({glass for glass, catalogue in known if catalogue.casefold() == name.casefold()})
    if not names:
        allowed = ", ".join(sorted({catalogue for _, catalogue in known}))
        raise InputError(f"--glasses {CATALOGUE}{name}: there is no such catalogue; allowed: {allowed}")
    usable = tuple(glass for glass in names if _is_known(specification, surface, glass))
    if not usable:
        raise InputError(
            f"--glasses {CATALOGUE}{name}: no glass of this catalogue has all data that the specification "
            "requires"
        )
    return usable


def _is_known(specification: Specification, surface: int, glass: str) -> bool:
    """Return whether a glass has all data that the specification requires."""
    try:
        validate_known(specification, surface, glass)
    except InputError:
        return False
    return True
