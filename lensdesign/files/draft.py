"""Common parts of the readers and writers of other programs' lens files.

The sequential files of :mod:`lensdesign.files.zemax` and :mod:`lensdesign.files.codev` list surfaces from the
object to the image, with coordinate breaks between them. A reader collects them in a :class:`Draft`, which
:func:`lensdesign.files.assembly.assemble` converts to a lens and its pose. The draft also lists everything
that a design cannot represent; the import fails unless the caller accepts these losses.
"""

from __future__ import annotations

import codecs
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lensdesign.common.input_files import LENS_FILE_BYTES, read_input
from lensdesign.common.number_limits import LARGEST_IN_FILES, SMALLEST_IN_FILES
from lensdesign.common.toml_files import joined_faults
from lensdesign.errors import InputError, MaterialError
from lensdesign.files.index_records import (
    INDEX_NOTED,
    INDEX_REFUSED,
    IndexRecord,
    index_difference,
)
from lensdesign.lens.coatings.coating import coating_text
from lensdesign.lens.glass import get_material, glass_summary, list_glasses, normalized_name
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.base import Shape
from lensdesign.lens.shapes.even_asphere import EvenAsphere
from lensdesign.lens.surface import Surface

MAX_SURFACES = 1000

NOTE = "transferlens"
"""First word of the comments that hold data of a design which the other program's format lacks."""

SEARCHED_MAKERS = ("SCHOTT", "OHARA", "HOYA", "CORNING", "HIKARI", "SUMITA", "CDGM")
"""Glass catalogues in the order in which they are searched if a file names none."""

GLASS_MAKERS = (*SEARCHED_MAKERS, "LZOS")
"""Makers of glass; several use the names of Schott's former glasses for glasses of their own."""

MAKERS_WITH_OTHER_NAMES = ("CDGM", "LZOS")
"""Makers whose names without a hyphen denote other glasses than those of Schott (F7: 1.636, not 1.625)."""

_REPLACED = "BAK1 BAK2 BK7 BK10 FK5 FK51 K5 LAF3 LAK8 LAK9 LAK21 PSK3 SK2 SK5 SK11 SK14 SK16"

REPLACED_SCHOTT_GLASSES = frozenset(_REPLACED.split())
"""Former glasses of Schott whose successors (N-BK7, ...) have the same dispersion formula.

The coefficients of both are equal to all digits in Schott's catalogue in the AGF format of 2000 to 2005.
"""

TOLERANCE_MM = 1e-9

NO_WAVELENGTH = "{}: no wavelength found; state it (--wavelength-um, Supplement(wavelengths_um=...))"

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)


class LossyImportError(InputError):
    """Raised if a design cannot represent a whole file; `dropped` lists the losses."""

    def __init__(self, source: str, dropped: Sequence[str]) -> None:
        self.dropped = tuple(dropped)
        listed = joined_faults([f"  {entry}" for entry in dropped])
        super().__init__(
            f"{source}: a design cannot represent the whole file; an import with --lossy omits\n{listed}"
        )


@dataclass(frozen=True)
class Imported:
    """Result of the import of another program's lens file.

    Attributes
    ----------
    lens, pose
        The lens, and the pose that the file's coordinate breaks give it.
    dropped
        Contents of the file that the lens cannot represent, with the file's surface numbers. Empty unless
        the import was lossy.
    remarks
        Replacements that do not change the present lens (solves and pickups replaced by their values), and
        the sources of glasses and of the stop's semi-diameter.
    first_order
        First-order data of the traced lens. They agree with those of the file's records.
    semi_diameters_mm
        Semi-diameter that the file states for each surface of the lens, including automatic ones, which the
        other program computed from rays; None where it states none.
    """

    lens: Lens
    pose: Pose = Pose()
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    first_order: ImportedFirstOrder | None = None
    semi_diameters_mm: tuple[float | None, ...] = ()


@dataclass(frozen=True)
class ImportedFirstOrder:
    """First-order data and marginal ray of an imported lens at its first wavelength.

    Attributes
    ----------
    efl_mm, bfl_mm
        Effective and back focal length in mm, in the medium behind the lens; inf for an afocal lens.
    magnification
        Transverse magnification of the object at the working distance; inf for an image at infinity.
    image_distance_mm
        Distance from the last vertex to the paraxial image in mm.
    object_na
        Sine of the marginal ray's angle at the object.
    stop_height_mm
        Height of the marginal ray at the stop in mm.
    """

    efl_mm: float
    bfl_mm: float
    magnification: float
    image_distance_mm: float
    object_na: float
    stop_height_mm: float


@dataclass(frozen=True)
class RecordedSurface:
    """A surface as the file records it, without any interpretation.

    `index` is what the file states on the index of the medium behind it, apart from the name of a glass.
    """

    curvature_per_mm: float
    distance_mm: float
    material: str | float | None
    stop: bool = False
    index: IndexRecord | None = None


@dataclass(frozen=True)
class Supplement:
    """Values that a design needs and another program's file may lack; a given value replaces the file's.

    Attributes
    ----------
    working_distance_mm, field_diameter_mm, numerical_aperture
        See :class:`lensdesign.ObjectSpace`. They are required if the object is at infinity, if the fields
        are angles, or if the file has no aperture, respectively.
    pixel_pitch_um, pixels, plane_distances_mm
        See :class:`lensdesign.Sensor`. Files of other programs usually lack the pixels.
    glass_catalogs
        Catalogue files that are searched for glasses first.
    wavelengths_um
        Wavelengths of the design; the first one is that of the design's indices.
    configuration
        Number of the configuration to read from a ``.zmx`` file, from 1.

    Examples
    --------
    >>> from lensdesign.files import Supplement
    >>> Supplement(pixel_pitch_um=3.2, pixels=(4000, 3000)).pixels
    (4000, 3000)
    """

    working_distance_mm: float | None = None
    field_diameter_mm: float | None = None
    numerical_aperture: float | None = None
    pixel_pitch_um: float | None = None
    pixels: tuple[int, int] | None = None
    plane_distances_mm: tuple[float, ...] | None = None
    glass_catalogs: tuple[Path, ...] = ()
    wavelengths_um: tuple[float, ...] | None = None
    configuration: int | None = None

    def wavelengths_or(self, found_um: Sequence[float], draft: Draft) -> list[float]:
        """Return the stated wavelengths, with a remark if they replace others; without any, those found.

        Raises
        ------
        InputError
            If one of them is not a positive length, before an index is computed from it.
        """
        used_um = self.wavelengths_um or found_um
        if any(not SMALLEST_IN_FILES <= w <= LARGEST_IN_FILES for w in used_um):
            listed = ", ".join(f"{w:g}" for w in used_um)
            origin = "wavelengths_um" if self.wavelengths_um else f"{draft.source}: wavelengths"
            raise InputError(f"{origin} = {listed}: must be greater than 0 and finite, in µm")
        if not self.wavelengths_um:
            return list(found_um)
        if found_um and list(found_um) != list(self.wavelengths_um):
            listed = ", ".join(f"{w:g}" for w in found_um)
            draft.add_remark(f"the stated wavelengths replace those of the file ({listed} µm)")
        return list(self.wavelengths_um)


def _turn(axis: int, angle: float) -> np.ndarray:
    """Return the right-handed rotation about an axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[i, j], [i, j]] = math.cos(angle)
    matrix[j, i], matrix[i, j] = math.sin(angle), -math.sin(angle)
    return matrix


@dataclass(frozen=True)
class CoordinateBreak:
    """A coordinate break: decenter, then tilts about x, the new y and the new z; or in reverse order."""

    decenter_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reverse: bool = False

    @property
    def is_identity(self) -> bool:
        """Whether the break moves nothing."""
        return not any(self.decenter_mm) and not any(self.tilt_deg)

    @property
    def text(self) -> str:
        """Values in words: decenters in the unit of the file, tilts in degrees."""
        decenters, tilts = (", ".join(f"{v:g}" for v in vs) for vs in (self.decenter_mm, self.tilt_deg))
        order = "tilts first" if self.reverse else "decenters first"
        return f"decenters {decenters}; tilts {tilts} degrees; {order}"

    def matrix(self) -> np.ndarray:
        """Return the homogeneous matrix (4, 4) from the axes behind the break to those before it."""
        shift, rotation = np.eye(4), np.eye(4)
        shift[:2, 3] = self.decenter_mm
        turns = [_turn(axis, math.radians(tilt)) for axis, tilt in enumerate(self.tilt_deg)]
        for turn in reversed(turns) if self.reverse else turns:
            rotation[:3, :3] = rotation[:3, :3] @ turn
        return rotation @ shift if self.reverse else shift @ rotation

    def inverse(self) -> CoordinateBreak:
        """Return the inverse of the coordinate break."""
        x, y = self.decenter_mm
        a, b, c = self.tilt_deg
        return CoordinateBreak((-x, -y), (-a, -b, -c), not self.reverse)

    def undoes(self, other: CoordinateBreak) -> bool:
        """Return whether this coordinate break is the inverse of another one."""
        own, expected = asdict(self), asdict(other.inverse())
        equal: bool = all(
            bool(np.allclose(own[k], expected[k], rtol=0.0, atol=1e-12)) for k in ("decenter_mm", "tilt_deg")
        )
        order_irrelevant = not any(self.tilt_deg) or (
            not any(self.decenter_mm) and np.count_nonzero(self.tilt_deg) < 2
        )
        return equal and bool(order_irrelevant or self.reverse != other.reverse)


@dataclass(frozen=True)
class SurfaceRow:
    """A surface of a file; the object comes first and the image last.

    If `axes` is given, the row is a coordinate break. `shape` holds the keys of a design file that describe
    the shape, except radius and conic constant, and `shape_class` is its class. `automatic_mm` is a
    semi-diameter that the other program computed from rays; it does not clip. `glass_semi_diameter_mm` is
    that of the surface itself if a stop that touches it clips more.
    """

    name: str
    location: str
    radius_mm: float | None = None
    conic: float = 0.0
    shape: dict[str, Any] = field(default_factory=dict)
    thickness_mm: float = 0.0
    material: str | float | None = None
    semi_diameter_mm: float | None = None
    stop: bool = False
    axes: CoordinateBreak | None = None
    automatic_mm: float | None = None
    shape_class: type[Shape] = EvenAsphere
    glass_semi_diameter_mm: float | None = None

    def scaled(self, factor: float) -> SurfaceRow:
        """Return the row with all lengths multiplied by a factor."""

        def times(length: float | None) -> float | None:
            return None if length is None else factor * length

        keys = {"radius_mm": self.radius_mm, "conic": self.conic, "asphere": ()} | self.shape
        keys |= self.shape_class.scaled_keys(keys, factor)
        axes = self.axes
        if axes is not None:
            x, y = axes.decenter_mm
            axes = replace(axes, decenter_mm=(factor * x, factor * y))
        return replace(
            self,
            radius_mm=keys["radius_mm"],
            shape={key: keys[key] for key in self.shape},
            thickness_mm=factor * self.thickness_mm,
            semi_diameter_mm=times(self.semi_diameter_mm),
            automatic_mm=times(self.automatic_mm),
            glass_semi_diameter_mm=times(self.glass_semi_diameter_mm),
            axes=axes,
        )


@dataclass
class Draft:
    """Contents of a file before they are assembled into a lens.

    `aperture` is a kind and its value: object_na, image_na, pupil_diameter_mm, image_f_number (focal length
    over entrance pupil diameter), working_f_number, or stop (the stop's semi-diameter counts, not the value).
    `recorded` holds the surfaces a second time, read independently of `rows`. The finished lens is compared
    with them (:mod:`lensdesign.files.first_order_check`). The keys of `dropped` and `remarks` are sentences,
    each listed once, in their order.
    """

    source: str
    title: str = ""
    wavelengths_um: list[float] = field(default_factory=list)
    rows: list[SurfaceRow] = field(default_factory=list)
    recorded: list[RecordedSurface] = field(default_factory=list)
    aperture: tuple[str, float] | None = None
    half_field_mm: float | None = None
    notes: dict[str, Any] = field(default_factory=dict)
    dropped: dict[str, None] = field(default_factory=dict)
    remarks: dict[str, None] = field(default_factory=dict)

    def add_loss(self, loss: str) -> None:
        """Add something that a design cannot represent, unless it is listed already."""
        self.dropped[loss] = None

    def add_remark(self, remark: str) -> None:
        """Add a remark on the import, unless it is listed already."""
        self.remarks[remark] = None

    def compare_index(
        self, name: str, material: str, record: IndexRecord, catalogs: Sequence[Path], is_foreign: bool
    ) -> None:
        """Add a remark or a loss if the data of a glass differ from what the file states on its index.

        A catalogue that the user gave is used as it is, with a remark.

        Parameters
        ----------
        name
            Name of the surface.
        material, catalogs
            Name of the glass in a design file, and the user's own catalogues.
        record
            The file's index record.
        is_foreign
            Whether the data are those of a catalogue that the file does not name; then the difference is
            always stated.
        """
        wavelength_um = self.wavelengths_um[0] if self.wavelengths_um else None
        difference = index_difference(material, record, wavelength_um, catalogs)
        if difference is None:
            return
        is_own = get_material(material, catalogs).catalog in {path.name for path in catalogs}
        if abs(difference.nd) > INDEX_REFUSED and not is_own:
            self.add_loss(
                f"{name}: glass {material} has {difference.text}; more than {INDEX_REFUSED:g} is another "
                "glass, or the record is that of a former one. Correct the wrong one, or give the glass "
                "catalogue that the file uses (AGF); --lossy uses the name"
            )
        elif is_foreign or abs(difference.nd) > INDEX_NOTED:
            self.add_remark(f"{name}: glass {material} has {difference.text}")

    def check_object_and_image(self) -> None:
        """Add a loss if the object or the image is curved, or if the object is not in air."""
        for row, kind in zip((self.rows[0], self.rows[-1]), ("object", "image"), strict=True):
            if row.radius_mm is not None:
                self.add_loss(f"{row.name}: curved {kind} surface")
        if self.rows[0].material is not None:
            self.add_loss(f"{self.rows[0].name}: object in {self.rows[0].material}, read as air")

    def apply_focus_shift(self) -> None:
        """Add the thickness of the image surface, which is a focus shift, to the distance in front of it."""
        shift_mm = self.rows[-1].thickness_mm
        if not shift_mm or len(self.rows) < 2:
            return
        self.add_remark(f"{self.rows[-1].name}: moved by its thickness, a focus shift of {shift_mm:.8g} mm")
        before, image = self.rows[-2:]
        self.rows[-2:] = [
            replace(before, thickness_mm=before.thickness_mm + shift_mm),
            replace(image, thickness_mm=0.0),
        ]
        if len(self.recorded) > 1:
            last, end = self.recorded[-2:]
            self.recorded[-2:] = [
                replace(last, distance_mm=last.distance_mm + shift_mm),
                replace(end, distance_mm=0.0),
            ]

    def scale_lengths(self, factor: float) -> None:
        """Multiply all lengths by the length of the file's unit in mm."""
        self.rows = [row.scaled(factor) for row in self.rows]
        self.recorded = [
            replace(s, curvature_per_mm=s.curvature_per_mm / factor, distance_mm=s.distance_mm * factor)
            for s in self.recorded
        ]
        if self.aperture is not None and self.aperture[0] == "pupil_diameter_mm":
            self.aperture = (self.aperture[0], self.aperture[1] * factor)
        if self.half_field_mm is not None:
            self.half_field_mm *= factor

    def set_field_heights(self, x_mm: Sequence[float], y_mm: Sequence[float]) -> None:
        """Set the half field to the largest distance of these object points from the axis."""
        pairs = zip_longest(x_mm, y_mm, fillvalue=0.0)
        self.half_field_mm = max((math.hypot(*pair) for pair in pairs), default=None)


@contextmanager
def losses_named(draft: Draft) -> Iterator[None]:
    """Add the losses found so far to the error of an unknown glass, which would hide them."""
    try:
        yield
    except MaterialError as error:
        if not draft.dropped:
            raise
        shown = 5
        more = f" and {len(draft.dropped) - shown} more" if len(draft.dropped) > shown else ""
        listed = "; ".join([*draft.dropped][:shown])
        raise MaterialError(
            f"{error}. A design cannot represent these parts either: {listed}{more}"
        ) from error


def read_lines(path: str | os.PathLike[str], binary_hint: str = "") -> list[str]:
    """Return the lines of a text file in UTF-8, UTF-16 (with or without a byte order mark) or Latin-1.

    Parameters
    ----------
    path
        The file.
    binary_hint
        What to do if the file is not a text file, for the message (default: no hint).

    Raises
    ------
    InputError
        If the file cannot be read, is larger than 20 MB, or is not a text file.
    """
    not_text = "not a text file" + (f"; {binary_hint}" if binary_hint else "")
    text = _decode(read_input(path, LENS_FILE_BYTES), str(path), not_text)
    if "\0" in text:
        raise InputError(f"cannot read {path}: {not_text}")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _decode(data: bytes, location: str, not_text: str) -> str:
    if data[:4:2] == b"\0\0" and data[1:4:2].isalnum():
        data = codecs.BOM_UTF16_BE + data
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or data[1:2] == b"\0":
        marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        try:
            return data.decode("utf-16" if marked else "utf-16-le")
        except UnicodeDecodeError as error:
            reason = "the file starts as UTF-16 text, but is not valid UTF-16" if marked else not_text
            raise InputError(f"cannot read {location}: {reason}") from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def starts_as_number(text: str) -> bool:
    """Return whether a word is meant as a number, which :func:`parse_number` may still refuse."""
    return text[:1] in "+-." or text[:1].isdigit()


def parse_number(text: str, location: str) -> float:
    """Return a finite number in the notation of other programs (1.5, .5, 1E-3, 1D-3).

    Raises
    ------
    InputError
        If the text is not a finite number; the message names the location.
    """
    value = math.nan
    if len(text) <= 400 and _NUMBER.fullmatch(text):
        value = float(text.lower().replace("d", "e"))
    if not math.isfinite(value):
        raise InputError(f"{location}: {quoted(text)} must be a finite number")
    return value


class FieldReader(Protocol):
    """State of a reader that collects field heights."""

    draft: Draft
    heights: dict[str, list[float]]


def field_height_reader(axis: str) -> Callable[[FieldReader, list[str], str], None]:
    """Return a function that reads the field heights along one axis."""

    def read(reader: FieldReader, values: list[str], location: str) -> None:
        reader.heights[axis] = [parse_number(v, location) for v in values]

    return read


def read_vignetting(reader: FieldReader, values: list[str], location: str) -> None:
    """Add a loss if a vignetting factor differs from 0."""
    if any(parse_number(v, location) for v in values):
        reader.draft.add_loss("vignetting factors")


def quoted(text: str) -> str:
    """Return a piece of a file in quotation marks, shortened to 40 characters, for messages."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def note_lines(lens: Lens, pose: Pose, folder: Path) -> list[str]:
    """Return one comment for each item of a design that the format lacks; :func:`read_note` reads them."""
    notes: dict[str, Any] = {
        "title": lens.title,
        "pixel_pitch_um": lens.sensor.pixel_pitch_um,
        "pixels": lens.sensor.pixels,
        "plane_distances_mm": lens.sensor.plane_distances_mm,
        "working_distance_mm": lens.object.working_distance_mm,
        "materials": [s.material if isinstance(s.material, str) else None for s in written_surfaces(lens)],
        "aperture": [lens.object.numerical_aperture, lens.stop_semi_diameter_mm],
    }
    if lens.glass_catalogs:
        notes["glass_catalogs"] = [os.path.relpath(c, folder.resolve()) for c in lens.glass_catalogs]
    if lens.edges:
        notes["edges"] = [edge.model_dump(mode="json", exclude_none=True) for edge in lens.edges]
    if lens.sensor.cover_glass is not None:
        notes["cover_glass"] = lens.sensor.cover_glass.model_dump(mode="json", exclude={"coating"})
    if lens.sensor.reflectance is not None:
        notes["reflectance"] = lens.sensor.reflectance
    if pose != Pose():
        notes["pose"] = asdict(pose)
    return [f"{NOTE} {key} {json.dumps(value)}" for key, value in notes.items()]


def written_surfaces(lens: Lens) -> tuple[Surface, ...]:
    """Return the surfaces of a file: those of the lens, and two planes for the cover glass of its sensor.

    The cover glass stands in front of the first recording plane. It does not move with a pose of the lens.
    """
    return *lens.surfaces, *cover_glass_surfaces(lens)


def cover_glass_surfaces(lens: Lens) -> tuple[Surface, ...]:
    """Return the two planes of the sensor's cover glass; none without one. The second has no distance."""
    glass = lens.sensor.cover_glass
    if glass is None:
        return ()
    return Surface(thickness_mm=glass.thickness_mm, material=glass.material), Surface()


def read_note(text: str, draft: Draft, location: str) -> None:
    """Read a comment of :func:`note_lines` into the draft; an unreadable one is recorded as a loss."""
    word, key, value = (*text.split(maxsplit=2), "", "", "")[:3]
    if word != NOTE:
        return
    try:
        draft.notes[key] = json.loads(value)
    except (ValueError, RecursionError) as error:  # cut short or folded by the program that saved it
        reason = str(error) if len(str(error)) < 80 else type(error).__name__
        draft.add_loss(
            f"remark {NOTE} {quoted(key)} ({location.rpartition(', ')[2]}): not readable: {reason}"
        )


def check_writable(lens: Lens, pose: Pose, convert_shape: Callable[[Shape], object], kind: str) -> None:
    """Check whether a sequential file can represent a lens and its pose.

    Parameters
    ----------
    lens, pose
        The lens and its pose.
    convert_shape
        Conversion of a shape to the format. It raises an InputError if the format lacks the shape.
    kind
        Name of the format, for messages.

    Raises
    ------
    InputError
        If a surface has a measured figure, if the format lacks a shape, or if the pose holds several trials.
    """
    for i, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            raise InputError(
                f"surface {i}: {kind} cannot represent a measured figure; remove it from the design first"
            )
        try:
            convert_shape(surface.shape)
        except InputError as error:
            raise InputError(f"surface {i}: {error}") from error
    if any(np.ndim(getattr(pose, f.name)) for f in fields(pose)):
        raise InputError(f"{kind} can represent a single pose only, not one for each trial")


def omissions(lens: Lens, kind: str) -> tuple[str, ...]:
    """Return a sentence for each surface whose coating or roughness a sequential file cannot contain.

    Parameters
    ----------
    lens
        The lens.
    kind
        Name of the format, for messages.
    """
    notes = []
    for i, surface in enumerate(lens.surfaces, start=1):
        if surface.coating != "ideal":
            text = coating_text(surface.coating, lens.wavelengths_um[0])
            notes.append(f"surface {i}: {kind} cannot contain its coating; omitted: {text}")
        if surface.roughness is not None:
            notes.append(f"surface {i}: {kind} cannot contain its roughness; omitted")
    glass = lens.sensor.cover_glass
    if glass is not None and glass.coating != "ideal":
        text = coating_text(glass.coating, lens.wavelengths_um[0])
        notes.append(f"cover glass: {kind} cannot contain its coating; omitted: {text}")
    return tuple(notes)


def pose_distances(lens: Lens, pose: Pose) -> tuple[float, float, float, float]:
    """Return distances: object to pivot, pivot to front vertex, exit vertex to pivot, pivot to first plane.

    All are in mm. The first and the last are measured along the axis of object and sensor, the others along
    the axis of the lens.
    """
    pivot, despace = float(np.asarray(pose.pivot_z_mm)), float(np.asarray(pose.despace_mm))
    exit_z = lens.exit_vertex_z_mm
    first = lens.sensor.plane_distances_mm[0]
    to_pivot = lens.object.working_distance_mm + despace + pivot
    return to_pivot, -pivot, pivot - exit_z, exit_z + first - pivot - despace


def pose_break(pose: Pose) -> CoordinateBreak:
    """Return the pose's decenter and tilts as a coordinate break at its pivot."""
    x, y, a, b = (
        float(np.asarray(v))
        for v in (pose.decenter_x_mm, pose.decenter_y_mm, pose.tilt_x_deg, pose.tilt_y_deg)
    )
    return CoordinateBreak((x, y), (a, b, 0.0))


def plain_title(title: str, excluded: str = "") -> str:
    """Return a title without line breaks, control characters and excluded characters."""
    return " ".join("".join(c if c.isprintable() and c not in excluded else " " for c in title).split())


def find_glass(
    name: str,
    makers: Iterable[str],
    catalogs: Sequence[Path],
    location: str,
    remark: Callable[[str], None] = lambda _: None,
) -> str:
    """Return the name of a glass in a design file.

    The user's own catalogues are searched first, those that the file names before the others; then the
    catalogues of the makers.

    Parameters
    ----------
    name
        Name as the file spells it. If a catalogue lacks this name, the only glass with the same letters and
        digits is used.
    makers
        Catalogues that the file names, in their order; none if the file does not name any.
    catalogs
        The user's own catalogue files.
    location
        File and line, for messages.
    remark
        Called with a sentence if the glass is the successor of a former one, if several catalogues have the
        glass, or if the catalogue has a note on it (default: no remarks).

    Raises
    ------
    MaterialError
        If no catalogue has the glass, or only that of a maker whom the file does not name. The reader never
        substitutes a similar glass.
    """
    makers = list(makers)
    if _is_builtin(name, catalogs):
        return name.upper()
    names_schott = not makers or any(maker.casefold() == "schott" for maker in makers)
    found = _glass_of_catalogues(name, makers, catalogs, remark, names_schott)
    if found is not None:
        return found
    maker = _maker_of(name, catalogs, location)
    if makers and maker.upper() in GLASS_MAKERS:
        named = ", ".join(dict.fromkeys(makers))
        others = {
            n: c
            for n, c in list_glasses(catalogs)
            if n.casefold() == name.casefold() and c.upper() not in GLASS_MAKERS
        }
        if len(others) == 1:  # a crystal or plastic whose name is also that of a glass
            ((found, maker),) = others.items()
            remark(f"{name} is {found} of {maker}; the file names the catalogues {named}")
            return found
        if "-" not in name:
            raise MaterialError(
                f"{location}: glass {quoted(name)} is not known from the catalogues that the file names "
                f"({named}); that of {maker} may differ from it. Give a glass catalogue (AGF) that has it"
            )
        remark(f"glass {name} is that of {maker}; the file names the catalogues {named}")
    elif makers and maker not in {path.name for path in catalogs}:
        named = ", ".join(dict.fromkeys(makers))
        remark(
            f"glass {name} has the data of {_source_of(name, catalogs)}; the file names the catalogues "
            f"{named}, and none of them that is available has it (give a glass catalogue, AGF, that has it)"
        )
    return name


def _is_builtin(name: str, catalogs: Sequence[Path]) -> bool:
    """Return whether a name is AIR or VACUUM, and no catalogue of the user has data of it."""
    own = {path.name for path in catalogs}
    return name.upper() in ("AIR", "VACUUM") and not any(
        n.casefold() == name.casefold() and c in own for n, c in list_glasses(catalogs)
    )


def _source_of(name: str, catalogs: Sequence[Path]) -> str:
    """Return the catalogue of a material; for a measurement from the literature also its author and year."""
    material = get_material(name, catalogs)
    if material.catalog != "refractiveindex.info":
        return material.catalog
    return f"{material.catalog} ({material.source.partition('; ')[2].partition(':')[0]})"


def _glass_of_catalogues(
    name: str,
    makers: Sequence[str],
    catalogs: Sequence[Path],
    remark: Callable[[str], None],
    names_schott: bool,
) -> str | None:
    """Return the glass of the user's own catalogues or those of the makers; None if they lack it.

    If `names_schott` is True, a former glass of Schott is read as its successor.
    """
    listed, wanted = list_glasses(catalogs), normalized_name(name)
    own = list(dict.fromkeys(path.name for path in catalogs))
    known: dict[str, str] = {}
    for _, catalog in listed:
        known.setdefault(catalog.casefold().removesuffix(".agf"), catalog)
    named = [known[key] for maker in makers if (key := maker.casefold().removesuffix(".agf")) in known]
    for catalog in dict.fromkeys([*(c for c in named if c in own), *own, *named]):
        is_schott = catalog not in own and catalog.casefold() == "schott"
        if is_schott and names_schott and name.upper() in REPLACED_SCHOTT_GLASSES:
            break
        alike = [n for n, c in listed if c == catalog and normalized_name(n) == wanted]
        exact = [n for n in alike if n.casefold() == name.casefold()] or alike
        if len(exact) == 1:
            found = _shortest_name(exact[0], catalog, catalogs)
            if catalog in own:
                others = {c for n, c in listed if c not in own and normalized_name(n) == wanted}
                if others:
                    remark(f"glass {name} is that of {catalog}, not of {' or '.join(sorted(others))}")
            else:
                _remark_same_names(name, found, named, listed, catalogs, remark)
            _remark_notes(found, catalogs, remark)
            return found
    if names_schott and name.upper() in REPLACED_SCHOTT_GLASSES:
        successor = f"N-{name.upper()}"
        remark(f"glass {name} is read as {successor}, its successor with the same dispersion formula")
        return _shortest_name(successor, "Schott", catalogs)
    return None


def _remark_same_names(
    name: str,
    found: str,
    named: Sequence[str],
    listed: Sequence[tuple[str, str]],
    catalogs: Sequence[Path],
    remark: Callable[[str], None],
) -> None:
    """Add a remark if another catalogue that the file names has a glass of this name with other data."""
    material, nd = get_material(found, catalogs), glass_summary(found, catalogs)["nd"]
    others = []
    for other, catalog in listed:
        is_same = normalized_name(other) == normalized_name(name)
        if not is_same or catalog == material.catalog or catalog not in named:
            continue
        other_nd = glass_summary(f"{catalog}:{other}", catalogs)["nd"]
        if nd is not None and other_nd is not None and abs(other_nd - nd) > INDEX_NOTED:
            others.append(f"that of {catalog} has {other_nd:.6f}")
    if others:
        remark(
            f"glass {name} is that of {material.catalog} with nd {nd:.6f}, whom the file names first; "
            f"{', '.join(others)}"
        )


def _maker_of(name: str, catalogs: Sequence[Path], location: str) -> str:
    try:
        return get_material(name, catalogs).catalog
    except MaterialError as error:
        advice = " Or give" if str(error).endswith("?") else "; give"
        raise MaterialError(f"{location}: {error}{advice} a glass catalogue (AGF) that has it") from error


def find_glass_of_unknown_maker(
    name: str, catalogs: Sequence[Path], location: str, remark: Callable[[str], None]
) -> str:
    """Return the name of a glass in a design file, for a file that does not name the maker.

    Parameters
    ----------
    name, catalogs, location
        See :func:`find_glass`.
    remark
        Called with a sentence on the catalogue that has the glass.

    Raises
    ------
    MaterialError
        If no catalogue has the glass, or only that of a maker who uses such names for other glasses.
    """
    if _is_builtin(name, catalogs):
        return name.upper()
    found = _glass_of_catalogues(name, SEARCHED_MAKERS, catalogs, remark, True) or name
    maker = _maker_of(found, catalogs, location)
    if maker in {path.name for path in catalogs}:
        return found
    if maker.upper() in MAKERS_WITH_OTHER_NAMES and "-" not in found:
        raise MaterialError(
            f"{location}: glass {quoted(name)} is known from {maker} alone, whose names of this form "
            "differ from Schott's; give a glass catalogue that has it"
        )
    remark(f"glass {name} is that of {maker}; the file does not name the catalogue")
    return found


def _remark_notes(name: str, catalogs: Sequence[Path], remark: Callable[[str], None]) -> None:
    try:
        for note in get_material(name, catalogs).notes:
            remark(note)
    except MaterialError:  # reported later, when the index is needed
        pass


def _shortest_name(name: str, maker: str, catalogs: Sequence[Path]) -> str:
    try:
        if get_material(name, catalogs).catalog == maker:
            return name
    except MaterialError:  # the name is ambiguous, or the catalogue's entry is invalid
        pass
    return f"{maker}:{name}"
