"""Semantic tolerances (PMI) of a glass body in STEP AP242: dimensions, geometric tolerances and datum A.

The indications of an ISO 10110 sheet become those of ISO 1101 that a CAD or measuring program reads:

- centre thickness: linear distance of the two optical surfaces, with its tolerance (±) if it has one;
- ground diameter: diameter of the edge cylinder, with its tolerance (±) if it has one;
- radius of a sphere: spherical radius, with the tolerance (±) that the sheet states or implies by 3/A;
- 3/A(B/C): profile of the surface without a datum, whose zone has the width of A and B together;
- 4/ tilt: circular run-out at the clear aperture against datum A, 2 h sin(tilt), of surfaces of revolution;
- 4/ lateral displacement: coaxiality with datum A, whose zone has twice the displacement as diameter.

Datum A is the axis of the edge cylinder, as on the sheet. OCP is imported inside the functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from lensdesign.errors import InputError
from lensdesign.lens.meridian import SurfaceMeridian
from lensdesign.lens.solid import Element
from lensdesign.manufacture.drawing.tolerances import DrawingTolerances, SurfaceTolerances
from lensdesign.manufacture.step.solids import rim_corners, subshapes

DATUM = "A"

DIGITS = 1e-11
"""Largest relative difference of numbers that a file represents with its 12 or 13 digits."""

DimensionKind = Literal["linear distance", "diameter", "spherical radius"]
GeometricKind = Literal["surface profile", "circular run-out", "coaxiality"]


@dataclass(frozen=True)
class Dimension:
    """A dimension.

    Attributes
    ----------
    kind
        Kind of the dimension.
    faces
        Indices of the faces of the solid that it measures, and of those to which it measures (empty for a
        size).
    value_mm, tolerance_mm
        Nominal value, and tolerance (±); None without one.
    """

    kind: DimensionKind
    faces: tuple[tuple[int, ...], tuple[int, ...]]
    value_mm: float
    tolerance_mm: float | None


@dataclass(frozen=True)
class GeometricTolerance:
    """A geometric tolerance of one face.

    Attributes
    ----------
    kind
        Kind of the tolerance.
    face
        Index of the face of the solid.
    zone_mm
        Width of the tolerance zone, or its diameter for a coaxiality.
    datum
        Name of the datum; empty without one.
    """

    kind: GeometricKind
    face: int
    zone_mm: float
    datum: str = ""


@dataclass(frozen=True)
class SemanticTolerances:
    """Semantic tolerances of one body.

    Attributes
    ----------
    dimensions, geometric
        Dimensions and geometric tolerances.
    datum_faces
        Indices of the faces of datum A; empty if no tolerance refers to it.
    """

    dimensions: tuple[Dimension, ...] = ()
    geometric: tuple[GeometricTolerance, ...] = ()
    datum_faces: tuple[int, ...] = ()

    def agrees(self, other: SemanticTolerances) -> bool:
        """Return whether the same features have the same values, to the digits of a file."""
        own, theirs = self._values(), other._values()
        return (
            self.datum_faces == other.datum_faces
            and len(self.dimensions) == len(other.dimensions)
            and len(self.geometric) == len(other.geometric)
            and own.keys() == theirs.keys()
            and all(
                math.isclose(one, two, rel_tol=DIGITS)
                for key, values in own.items()
                for one, two in zip(values, theirs[key], strict=True)
            )
        )

    def _values(self) -> dict[tuple[Any, ...], tuple[float, ...]]:
        """Return the values of each feature; a feature has one tolerance of a kind."""
        sizes = {
            (one.kind, one.faces, one.tolerance_mm is None): (one.value_mm, one.tolerance_mm or 0.0)
            for one in self.dimensions
        }
        zones = {(one.kind, one.face, one.datum): (one.zone_mm,) for one in self.geometric}
        return {**sizes, **zones}

    @property
    def count(self) -> int:
        """Number of toleranced dimensions and geometric tolerances."""
        return sum(one.tolerance_mm is not None for one in self.dimensions) + len(self.geometric)


def semantic_tolerances(element: Element, tolerances: DrawingTolerances) -> SemanticTolerances:
    """Return the semantic tolerances of a body.

    Parameters
    ----------
    element
        The body. The faces of its solid are the front surface, one face for each segment of the rim, and the
        back surface.
    tolerances
        Tolerances of its sheet; geometric tolerances without a value are left out.
    """
    corners = rim_corners(element)
    outer_mm = element.outer_mm
    # Faces of the edge, which are cylinders or, with draft, cones. The rim of the flange is no datum.
    walls = tuple(
        index
        for index, (((r0, z0), (r1, z1)), on_edge) in enumerate(
            zip(pairwise(corners), pairwise(element.on_edge(corners)), strict=True), start=1
        )
        if all(on_edge) and z0 != z1 and (element.edge.flange is None or min(r0, r1) < outer_mm)
    )
    cylinders = () if any(element.draft_mm) else walls
    front, back = 0, len(corners)
    thickness = element.center_thickness_mm
    # OCP 8.0 writes geometric tolerances in metres if the file has no dimension.
    dimensions = [Dimension("linear distance", ((front,), (back,)), thickness, tolerances.thickness_mm)]
    if cylinders:
        diameter = 2.0 * element.edge_mm
        dimensions.append(Dimension("diameter", (cylinders, ()), diameter, tolerances.diameter_mm))
    geometric: list[GeometricTolerance] = []
    sides = ((front, element.front, tolerances.left), (back, element.back, tolerances.right))
    for face, meridian, side in sides:
        surface, fringe_um = meridian.surface, tolerances.fringe_wavelength_um
        allowed = side.radius_allowed_mm(surface, fringe_um)
        if surface.kind == "sphere" and surface.radius_mm is not None and allowed:
            radius = abs(surface.radius_mm)
            dimensions.append(Dimension("spherical radius", ((face,), ()), radius, allowed))
        if zone := _profile_mm(meridian, side, fringe_um):
            geometric.append(GeometricTolerance("surface profile", face, zone))
        # The run-out of a surface that is not one of revolution also contains its shape.
        if side.centring_arcmin and walls and surface.shape.ROTATIONAL:
            height = surface.semi_diameter_mm or meridian.end_mm
            runout = 2.0 * height * math.sin(math.radians(side.centring_arcmin / 60.0))
            geometric.append(GeometricTolerance("circular run-out", face, runout, DATUM))
        if side.decenter_mm and walls:
            geometric.append(GeometricTolerance("coaxiality", face, 2.0 * side.decenter_mm, DATUM))
    uses_datum = any(one.datum for one in geometric)
    return SemanticTolerances(tuple(dimensions), tuple(geometric), walls if uses_datum else ())


def _profile_mm(meridian: SurfaceMeridian, side: SurfaceTolerances, fringe_um: float) -> float:
    """Return the width of the zone that 3/A(B/C) allows around the nominal surface; 0 without A and B.

    A tolerance of the radius counts as the sagitta error that it causes at the clear aperture. Form
    tolerances of a part of the aperture have no zone.
    """
    height = meridian.surface.semi_diameter_mm or meridian.end_mm
    if side.test_diameter_mm is not None and side.test_diameter_mm < 2.0 * height:
        return 0.0
    fringes = (side.radius_fringes or 0.0) + (side.irregularity_fringes or 0.0)
    radius = meridian.surface.radius_mm
    by_radius = 0.0 if side.radius_mm is None or radius is None else side.radius_mm * (height / radius) ** 2
    return 0.5 * (1e-3 * fringe_um * fringes + by_radius)


def add_tolerances(document: Any, part: Any, faces: Sequence[Any], stated: SemanticTolerances) -> None:
    """Add the semantic tolerances of a body to a document of OCP.

    Parameters
    ----------
    document
        A TDocStd_Document.
    part
        Label of the body's solid.
    faces
        Faces of the solid, in their order.
    stated
        The tolerances.
    """
    from OCP.TCollection import TCollection_HAsciiString
    from OCP.XCAFDimTolObjects import (
        XCAFDimTolObjects_DatumObject,
        XCAFDimTolObjects_DimensionObject,
        XCAFDimTolObjects_GeomToleranceObject,
    )
    from OCP.XCAFDoc import XCAFDoc_Datum, XCAFDoc_Dimension, XCAFDoc_DocumentTool, XCAFDoc_GeomTolerance

    shapes = XCAFDoc_DocumentTool.ShapeTool_s(document.Main())
    tool = XCAFDoc_DocumentTool.DimTolTool_s(document.Main())

    def labels(indices: Sequence[int]) -> Any:
        sequence = _labels()
        for index in indices:
            sequence.Append(shapes.AddSubShape(part, faces[index]))
        return sequence

    dimension_types, geometric_types = _types()
    for dimension in stated.dimensions:
        label = tool.AddDimension()
        first, second = map(labels, dimension.faces)
        tool.SetDimension(first, second, label)
        size = XCAFDimTolObjects_DimensionObject()
        size.SetType(dimension_types[dimension.kind])
        size.SetValue(dimension.value_mm)
        if dimension.tolerance_mm is not None:
            size.SetUpperTolValue(dimension.tolerance_mm)
            # OCP stores the lower tolerance without its sign, and writes it with it.
            size.SetLowerTolValue(dimension.tolerance_mm)
        XCAFDoc_Dimension.Set_s(label).SetObject(size)
    datum = None
    if stated.datum_faces:
        datum = tool.AddDatum()
        tool.SetDatum(labels(stated.datum_faces), datum)
        feature = XCAFDimTolObjects_DatumObject()
        feature.SetName(TCollection_HAsciiString(DATUM))
        feature.SetPosition(1)
        XCAFDoc_Datum.Set_s(datum).SetObject(feature)
    for tolerance in stated.geometric:
        label = tool.AddGeomTolerance()
        tool.SetGeomTolerance(labels((tolerance.face,)), label)
        zone = XCAFDimTolObjects_GeomToleranceObject()
        zone.SetType(geometric_types[tolerance.kind])
        # For a value that is marked as a diameter, OCP 8.0 also writes the zone of a run-out.
        zone.SetValue(tolerance.zone_mm)
        XCAFDoc_GeomTolerance.Set_s(label).SetObject(zone)
        if tolerance.datum and datum is not None:
            tool.SetDatumToGeomTol(datum, label)


def _types() -> tuple[dict[DimensionKind, Any], dict[GeometricKind, Any]]:
    """Return the types of OCP by kind."""
    from OCP.XCAFDimTolObjects import XCAFDimTolObjects_DimensionType, XCAFDimTolObjects_GeomToleranceType

    dimension, geometric = XCAFDimTolObjects_DimensionType, XCAFDimTolObjects_GeomToleranceType
    return (
        {
            "linear distance": dimension.XCAFDimTolObjects_DimensionType_Location_LinearDistance,
            "diameter": dimension.XCAFDimTolObjects_DimensionType_Size_Diameter,
            "spherical radius": dimension.XCAFDimTolObjects_DimensionType_Size_SphericalRadius,
        },
        {
            "surface profile": geometric.XCAFDimTolObjects_GeomToleranceType_ProfileOfSurface,
            "circular run-out": geometric.XCAFDimTolObjects_GeomToleranceType_CircularRunout,
            "coaxiality": geometric.XCAFDimTolObjects_GeomToleranceType_Coaxiality,
        },
    )


def read_tolerances(document: Any) -> list[SemanticTolerances]:
    """Return the semantic tolerances of each part of a document that OCP read, in the order of the parts.

    Raises
    ------
    InputError
        If a tolerance is of another kind, or refers to something else than faces of one part.
    """
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.XCAFDoc import (
        XCAFDoc_Datum,
        XCAFDoc_Dimension,
        XCAFDoc_DimTolTool,
        XCAFDoc_DocumentTool,
        XCAFDoc_GeomTolerance,
        XCAFDoc_ShapeTool,
    )

    tool = XCAFDoc_DocumentTool.DimTolTool_s(document.Main())
    faces = [
        subshapes(XCAFDoc_ShapeTool.GetShape_s(part), TopAbs_ShapeEnum.TopAbs_FACE)
        for part in _parts(document)
    ]

    def located(label: Any) -> tuple[int, tuple[tuple[int, ...], tuple[int, ...]]]:
        """Return the part and the faces to which a label of a tolerance refers."""
        first, second = _labels(), _labels()
        XCAFDoc_DimTolTool.GetRefShapeLabel_s(label, first, second)
        shapes = [[XCAFDoc_ShapeTool.GetShape_s(one) for one in _listed(side)] for side in (first, second)]
        for part, own in enumerate(faces):
            found = [
                [i for shape in side for i, face in enumerate(own) if face.IsSame(shape)] for side in shapes
            ]
            if [len(side) for side in found] == [len(side) for side in shapes] and found[0]:
                return part, (tuple(sorted(found[0])), tuple(sorted(found[1])))
        raise InputError("a tolerance read back does not refer to faces of one solid")

    dimension_types, geometric_types = _types()
    dimensions: list[list[Dimension]] = [[] for _ in faces]
    geometric: list[list[GeometricTolerance]] = [[] for _ in faces]
    datums: list[tuple[int, ...]] = [() for _ in faces]
    for label in _found(tool.GetDimensionLabels):
        size, (part, of) = XCAFDoc_Dimension.Set_s(label).GetObject(), located(label)
        kind, tolerance = _kind(dimension_types, size.GetType()), None
        if size.IsDimWithPlusMinusTolerance():
            tolerance, lower = size.GetUpperTolValue(), size.GetLowerTolValue()
            if not math.isclose(tolerance, lower, rel_tol=DIGITS):
                raise InputError(f"a {kind} has the tolerances +{tolerance:g} and -{lower:g} when read back")
        dimensions[part].append(Dimension(kind, of, size.GetValue(), tolerance))
    for label in _found(tool.GetGeomToleranceLabels):
        zone, (part, of) = XCAFDoc_GeomTolerance.Set_s(label).GetObject(), located(label)
        names = []
        references = _labels()
        XCAFDoc_DimTolTool.GetDatumOfTolerLabels_s(label, references)
        for reference in _listed(references):
            names.append(XCAFDoc_Datum.Set_s(reference).GetObject().GetName().ToCString())
            datums[part] = located(reference)[1][0]
        kind = _kind(geometric_types, zone.GetType())
        geometric[part].append(GeometricTolerance(kind, of[0][0], zone.GetValue(), "".join(names)))
    return [
        SemanticTolerances(tuple(sizes), tuple(zones), datum)
        for sizes, zones, datum in zip(dimensions, geometric, datums, strict=True)
    ]


def _kind(types: dict[Any, Any], found: Any) -> Any:
    for kind, of_ocp in types.items():
        if of_ocp == found:
            return kind
    raise InputError(f"a tolerance is of the kind {found} when read back")


def _parts(document: Any) -> Iterator[Any]:
    """Yield the labels of the parts: of the only one, or of those of the assembly."""
    from OCP.TDF import TDF_Label
    from OCP.XCAFDoc import XCAFDoc_DocumentTool, XCAFDoc_ShapeTool

    roots = _labels()
    XCAFDoc_DocumentTool.ShapeTool_s(document.Main()).GetFreeShapes(roots)
    for root in _listed(roots):
        if not XCAFDoc_ShapeTool.IsAssembly_s(root):
            yield root
            continue
        components = _labels()
        XCAFDoc_ShapeTool.GetComponents_s(root, components)
        for component in _listed(components):
            part = TDF_Label()
            XCAFDoc_ShapeTool.GetReferredShape_s(component, part)
            yield part


def _labels() -> Any:
    from OCP.collections import Sequence_TDF_Label

    return Sequence_TDF_Label()


def _listed(sequence: Any) -> list[Any]:
    return [sequence.Value(i) for i in range(1, sequence.Length() + 1)]


def _found(get: Any) -> list[Any]:
    sequence = _labels()
    get(sequence)
    return _listed(sequence)
