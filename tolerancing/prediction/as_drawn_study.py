"""The study of a drawing: each indication of the drawing as perturbations of the lens.

A part may have every deviation that its drawing allows. Indications therefore become perturbations as
follows, whether or not the study has them:

==================================  ==================================================================
indication                          perturbation
==================================  ==================================================================
radius, mm                          ``surface N radius_mm``, by the same amount to both sides
3/A, fringe spacings                ``surface N radius_mm``: a sagitta of A wavelength / 2 at the clear (or
                                    test) semi-diameter h equals a radius change of A wavelength R^2 / h^2.
                                    None for a plane; refocusing removes most of the effect of its power
3/(B)                               ``surface N irregularity_pv_waves``: 0 to B half wavelengths of sag
RMSi < D                            ``surface N irregularity_rms_waves``: D half wavelengths instead of B
4/ angle                            ``surface N tilt_x_deg`` and ``tilt_y_deg``, each up to the angle, against
                                    the ground edge. A tilt of the whole element in its mount is a different
                                    perturbation
4/ (displacement)                   ``surface N decenter_x_mm`` and ``decenter_y_mm`` of an asphere
conic constant                      ``surface N conic``
thickness                           ``surface N thickness_mm`` of the front surface
index, Abbe number                  ``surface N index`` and ``abbe_percent`` of the front surface
2/A;                                ``surface N irregularity_pv_waves``: the sag of one surface with the path
                                    difference of the thickness times twice the index deviation of class A
diameter, chamfer, 0/, 1/, 5/, 6/   none: they do not change the wavefront
==================================  ==================================================================

The value of an indication is the tolerance of the distribution. A perturbation of the study keeps its own
distribution. An indication that the study does not perturb has the distribution of the same parameter
elsewhere in the study, or else a uniform one over the allowed range.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from lensdesign.lens.lens import Lens
from lensdesign.lens.solid import glass_elements, mechanical_semi_diameter_mm
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.manufacture.drawing.tolerances import GENERAL, DrawingTolerances, general_tolerances
from tolerancing.perturbations.distributions.base import Distribution
from tolerancing.perturbations.distributions.bounded import Uniform
from tolerancing.perturbations.grades import COMMERCIAL
from tolerancing.perturbations.parameters import IRREGULARITIES, Perturbation, with_unit
from tolerancing.prediction.drawing_indication import (
    FIELDS,
    OF_ELEMENT,
    Deviation,
    DrawingIndication,
    Key,
    Kind,
    Origin,
)
from tolerancing.study.study import Study

HOMOGENEITY = (50e-6, 20e-6, 5e-6, 2e-6, 1e-6, 0.5e-6)
"""Largest deviation (+-) of the index within a part by class (ISO 10110-4)."""


def drawing_indications(
    lens: Lens, study: Study, sheets: Sequence[DrawingTolerances]
) -> tuple[DrawingIndication, ...]:
    """Return all indications that a prediction uses, element by element.

    Values that a sheet does not state are the general tolerances, which ISO 10110 prescribes in this case.
    Glass data and the decenter of aspheres have no general tolerance; they have the commercial grade.

    Parameters
    ----------
    lens
        The lens as drawn.
    study
        Its tolerance study.
    sheets
        Tolerances of each element's sheet.
    """
    stated = {key for p in study.perturbations if (key := indication_key(p, lens)) and stated_value(p, lens)}
    found = dict[Key, DrawingIndication]()
    for element, sheet in zip(glass_elements(lens), sheets, strict=True):
        size = max(2.0 * element.edge_mm, element.center_thickness_mm)
        general = general_tolerances(min(size, max(GENERAL)))
        for kind, fields in FIELDS.items():
            for surface in element.surfaces[:1] if kind in OF_ELEMENT else element.surfaces:
                if not _has(lens, kind, surface):
                    continue
                side = "left" if surface == element.surfaces[0] else "right"
                own, usual = (t if kind in OF_ELEMENT else getattr(t, side) for t in (sheet, general))
                field = next((f for f in fields if getattr(own, f) not in (None, "")), None)
                origin: Origin = "open"
                if field is not None:
                    origin = "general" if field in own.general else "sheet"
                    if (kind, surface) in stated and origin != "general":
                        origin = "study"
                name = field or fields[-1]
                value = getattr(own, name) if field else getattr(usual, name)
                number = _number(kind, value)
                if number is None:
                    continue
                if field is None and "fringes" in name:
                    ratio = general.fringe_wavelength_um / sheet.fringe_wavelength_um
                    number = float(f"{ratio * number:.4g}")
                item = DrawingIndication(kind, element.index, surface, name, number, origin, ())
                # The sheet that allows more determines the value of a cemented surface.
                other = found.get(item.key)
                if other is None or (other.field == name and other.value < number):
                    found[item.key] = with_value(item, lens, sheet, number)
    return tuple(item for item in found.values() if item.deviations)


def _has(lens: Lens, kind: Kind, surface: int) -> bool:
    """Return whether a kind of indication applies to a surface."""
    own = lens.surfaces[surface]
    if kind == "radius":
        return own.radius_mm is not None
    if kind == "irregularity":
        return own.semi_diameter_mm is not None
    if kind == "conic" and "conic" not in own.shape_parameters:
        return False
    if kind in ("decenter", "conic"):
        return own.kind not in ("plane", "sphere")
    return kind != "Abbe number" or isinstance(own.material, str)


def _number(kind: Kind, value: float | str | None) -> float | None:
    """Return a value of a sheet, or its default, as a number; None if there is neither."""
    if kind == "inhomogeneity":
        # Class of usual optical glass, used if a drawing states none.
        usual_inhomogeneity = "1;1"
        match = re.match(r"\s*([0-5])\s*;", str(value or usual_inhomogeneity))
        return float(match[1]) if match else None
    if value is None:
        usual = {
            "decenter": COMMERCIAL.asphere_decenter_mm,
            "index": COMMERCIAL.index,
            "Abbe number": COMMERCIAL.abbe_percent,
        }
        return usual.get(kind)
    assert not isinstance(value, str)
    return value or None


def with_value(
    item: DrawingIndication, lens: Lens, sheet: DrawingTolerances, value: float
) -> DrawingIndication:
    """Return the item with a value and the deviations that it allows."""
    fringe = sheet.fringe_wavelength_um
    target, surface = f"surface {item.surface + 1}", lens.surfaces[item.surface]
    waves = 0.5 * fringe / TEST_WAVELENGTH_UM * value
    found: tuple[tuple[str, float | None], ...]
    if item.kind == "radius":
        side = sheet.left if item.surface == lens.glass_fronts[item.element] else sheet.right
        one = side.replaced(radius_mm=None, radius_fringes=None).replaced(**{item.field: value})
        found = (("radius_mm", one.radius_allowed_mm(surface, fringe)),)
    elif item.kind == "irregularity":
        rms = item.field.startswith("rms")
        found = ((IRREGULARITIES[1] if rms else IRREGULARITIES[0], waves),)
    elif item.kind == "centring":
        found = (("tilt_x_deg", value / 60.0), ("tilt_y_deg", value / 60.0))
    elif item.kind == "decenter":
        found = (("decenter_x_mm", value), ("decenter_y_mm", value))
    elif item.kind == "inhomogeneity":
        found = ((IRREGULARITIES[0], _inhomogeneity_waves(lens, item.surface, HOMOGENEITY[int(value)])),)
        target = f"surface {_refracting(lens, item.surface) + 1}"
    else:
        found = ((item.field, value),)
    deviations = tuple(Deviation(target, name, size) for name, size in found if size)
    return replace(item, value=value, deviations=deviations)


def _refracting(lens: Lens, front: int) -> int:
    """Return the surface of an element that has a clear aperture and the larger step of the index."""
    n = lens.indices(lens.wavelengths_um[0])
    sized = [i for i in (front, front + 1) if lens.surfaces[i].semi_diameter_mm is not None]
    return max(sized or [front], key=lambda i: abs(float(n[i + 1] - n[i])))


def _inhomogeneity_waves(lens: Lens, front: int, deviation: float) -> float | None:
    """Return the sag in waves of 632.8 nm (peak to valley) that changes a path as the inhomogeneity does."""
    n, surface = lens.indices(lens.wavelengths_um[0]), _refracting(lens, front)
    if lens.surfaces[surface].semi_diameter_mm is None:
        return None
    path_mm = 2.0 * deviation * (lens.surfaces[front].thickness_mm or 0.0)
    return 1e3 * path_mm / abs(float(n[surface + 1] - n[surface])) / TEST_WAVELENGTH_UM


def indication_key(p: Perturbation, lens: Lens) -> Key | None:
    """Return kind and surface of the indication of a perturbation; None if no indication corresponds."""
    if p.element is not None:
        edge = p.parameter.startswith("edge_difference")
        return ("centring", lens.glass_fronts[p.element] + 1) if edge else None
    if p.surface is None:
        return None
    kinds: dict[str, Kind] = {
        "tilt_x_deg": "centring",
        "tilt_y_deg": "centring",
        "tir_x_mm": "centring",
        "tir_y_mm": "centring",
        "decenter_x_mm": "decenter",
        "decenter_y_mm": "decenter",
        "conic": "conic",
        "radius_mm": "radius",
        "radius_percent": "radius",
        "radius_fringes": "radius",
        **dict.fromkeys(IRREGULARITIES, "irregularity"),
    }
    glass: dict[str, Kind] = {"thickness_mm": "thickness", "index": "index", "abbe_percent": "Abbe number"}
    kind = kinds.get(p.parameter) or (glass.get(p.parameter) if p.surface in lens.glass_fronts else None)
    return None if kind is None else (kind, p.surface)


def stated_value(p: Perturbation, lens: Lens) -> float | None:
    """Return the tolerance of a perturbation in the unit of its indication; None if it was measured.

    Tolerances of radii and irregularities keep the unit of the perturbation, because they are not compared
    with others.
    """
    if p.file_name is not None:
        return None
    size = p.tolerance
    if p.parameter.startswith("tilt"):
        return 60.0 * size
    if p.parameter.startswith(("tir", "edge_difference")):
        reach = (
            mechanical_semi_diameter_mm(lens, p.element)
            if p.element is not None
            else lens.surfaces[p.surface or 0].semi_diameter_mm
        )
        return None if reach is None else 60.0 * math.degrees(math.asin(min(size / (2.0 * reach), 1.0)))
    return size


@dataclass(frozen=True)
class AsDrawnStudy:
    """A study with all deviations that a drawing allows.

    Attributes
    ----------
    study
        The study: its own perturbations, then those that the sheet adds.
    items
        Item that added each perturbation; None for the study's own.
    """

    study: Study
    items: tuple[DrawingIndication | None, ...]


def as_drawn_study(lens: Lens, study: Study, items: Sequence[DrawingIndication]) -> AsDrawnStudy:
    """Return the study of a drawing.

    Parameters
    ----------
    lens
        The lens as drawn.
    study
        Its tolerance study. Perturbations without an indication (mount, object, sensor, light) stay.
    items
        Indications from :func:`drawing_indications`.
    """
    by_key = {item.key: item for item in items}
    kept, owners, dropped = list[Perturbation](), list[DrawingIndication | None](), set[str]()
    for p in study.perturbations:
        key = indication_key(p, lens)
        item = by_key.get(key) if key else None
        value = stated_value(p, lens)
        if item is not None and item.origin != "study" and value is None:
            dropped.add(p.column)  # a measured distribution: parts are made to the sheet's value instead
            continue
        closer = item is not None and item.kind in ("centring", "decenter") and value is not None
        factor = item.value / value if item is not None and value and closer else 1.0
        kept.append(p.scaled(factor) if factor < 0.999 else p)
        owners.append(None)
    for item in items:
        own = [
            p for p in study.perturbations if indication_key(p, lens) == item.key and p.column not in dropped
        ]
        missing = _axes_left(item, own) if item.origin == "study" else item.deviations
        for deviation in missing:
            kept.append(_new(lens, item, deviation, study, {p.column for p in kept}))
            owners.append(item)
    correlations = tuple(
        c for c in study.correlations if not dropped & ({*c.names} | {with_unit(n, "mm") for n in c.names})
    )
    changes: dict[str, Any] = {"perturbations": tuple(kept)}
    if dropped:
        changes["correlations"] = correlations
    return AsDrawnStudy(study.model_copy(update=changes), tuple(owners))


def _axes_left(item: DrawingIndication, own: Sequence[Perturbation]) -> tuple[Deviation, ...]:
    """Return the deviations of an indication along axes that the study does not perturb."""
    # A runout along y is a tilt about x.
    about = {"tir_y_mm": "x", "tir_x_mm": "y", "edge_difference_y_mm": "x", "edge_difference_x_mm": "y"}
    axes = {about.get(p.parameter, p.parameter.partition("_")[2][:1]) for p in own}
    directed = [d for d in item.deviations if d.parameter.startswith(("tilt_", "decenter_"))]
    return tuple(d for d in directed if d.parameter.split("_")[1] not in axes)


def _new(
    lens: Lens, item: DrawingIndication, deviation: Deviation, study: Study, existing: set[str]
) -> Perturbation:
    """Return a perturbation with the size of a deviation, distributed like others of its kind."""
    kind = "irregularity" if item.kind == "inhomogeneity" else item.kind
    similar = (p for p in study.perturbations if (key := indication_key(p, lens)) and key[0] == kind)
    template = next((p for p in similar if p.file_name is None), None)
    irregular = deviation.parameter in IRREGULARITIES
    if template is None:
        half = 0.5 * deviation.tolerance if irregular else deviation.tolerance
        distribution: Distribution = Uniform(mean=half if irregular else 0.0, half_width=half)
    else:
        distribution = template.scaled(deviation.tolerance / template.tolerance).distribution
        if not irregular:
            distribution = distribution.replaced(mean=0.0)
    target, parameter = deviation.target, deviation.parameter
    found = Perturbation(target=target, parameter=parameter, distribution=distribution)
    if found.column not in existing and item.kind != "inhomogeneity":
        return found
    name = f"{item.label} {parameter}".replace(" ", "_").lower()
    return Perturbation(name=name, target=target, parameter=parameter, distribution=distribution)
