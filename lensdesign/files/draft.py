"""What the files of other lens design programs have in common: read strictly, assembled into a lens.

The sequential files of :mod:`lensdesign.files.zemax` and :mod:`lensdesign.files.codev` hold rows of surfaces
from the object to the image, and coordinate breaks between them. Here such rows become a lens and its pose.
What they hold and a design cannot is listed, and refused unless the caller accepts the loss.
"""

from __future__ import annotations

import codecs
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import zip_longest
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lensdesign.common.input_files import LENS_FILE_BYTES, read_input
from lensdesign.common.toml_files import joined_faults
from lensdesign.errors import InputError, MaterialError
from lensdesign.lens.glass import get_material, list_glasses
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.lens.shapes.base import Shape

MOST_SURFACES = 1000

NOTE = "transferlens"
"""First word of the remarks in which a design's own data travels through another program's file."""

TOLERANCE_MM = 1e-9

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)


class LossyImportError(InputError):
    """A file that holds what a design cannot; `dropped` lists it."""

    def __init__(self, source: str, dropped: Sequence[str]) -> None:
        self.dropped = tuple(dropped)
        listed = joined_faults([f"  {entry}" for entry in dropped])
        super().__init__(f"{source}: a design cannot hold all of it; a lossy import leaves out\n{listed}")


@dataclass(frozen=True)
class Imported:
    """What was read from another program's file.

    Attributes
    ----------
    lens, pose
        The lens, and where the file's coordinate breaks put it.
    dropped
        What the file holds and the lens cannot, with the file's surface numbers; empty unless a lossy import
        was asked for.
    remarks
        What was replaced by its present value, and loses nothing of the lens as it stands: solves, pickups;
        and where glasses and the size of the stop were taken from.
    first_order
        First-order data of the lens as traced, which agree with those by the file's records.
    """

    lens: Lens
    pose: Pose = Pose()
    dropped: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    first_order: ImportedFirstOrder | None = None


@dataclass(frozen=True)
class ImportedFirstOrder:
    """What an imported lens does to paraxial rays, and its marginal ray, at its first wavelength.

    Attributes
    ----------
    efl_mm, bfl_mm
        Effective and back focal length; inf for an afocal lens.
    magnification
        Transverse, of the object at the working distance into its paraxial image; inf where that is at
        infinity.
    image_distance_mm
        From the last vertex to the paraxial image of the object.
    object_na
        Sine of the marginal ray's angle at the object.
    stop_height_mm
        Height of that ray at the stop.
    """

    efl_mm: float
    bfl_mm: float
    magnification: float
    image_distance_mm: float
    object_na: float
    stop_height_mm: float


@dataclass(frozen=True)
class RecordedSurface:
    """A surface as the records of a file have it, before anything was made of them."""

    curvature_per_mm: float
    distance_mm: float
    material: str | float | None
    stop: bool = False


@dataclass(frozen=True)
class Supplement:
    """What a design needs and another program's file may not tell; a value given here replaces the file's.

    Attributes
    ----------
    working_distance_mm, field_diameter_mm, numerical_aperture
        As in :class:`lensdesign.ObjectSpace`; needed where the object is at infinity, the fields are
        angles, or there is no aperture.
    pixel_pitch_um, pixels, plane_distances_mm
        As in :class:`lensdesign.Sensor`.
    glass_catalogs
        Catalogue files in which glasses are sought first.
    """

    working_distance_mm: float | None = None
    field_diameter_mm: float | None = None
    numerical_aperture: float | None = None
    pixel_pitch_um: float | None = None
    pixels: tuple[int, int] | None = None
    plane_distances_mm: tuple[float, ...] | None = None
    glass_catalogs: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Break:
    """A change of axes: decenter, then tilts about x, turned y and turned z; or all in reverse order."""

    decenter_mm: tuple[float, float] = (0.0, 0.0)
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reverse: bool = False

    def inverse(self) -> Break:
        """What undoes it."""
        x, y = self.decenter_mm
        a, b, c = self.tilt_deg
        return Break((-x, -y), (-a, -b, -c), not self.reverse)

    def undoes(self, other: Break) -> bool:
        """Whether this is the other's inverse."""
        mine, wanted = asdict(self), asdict(other.inverse())
        alike: bool = all(
            bool(np.allclose(mine[k], wanted[k], rtol=0.0, atol=1e-12)) for k in ("decenter_mm", "tilt_deg")
        )
        one_kind = not any(self.tilt_deg) or (
            not any(self.decenter_mm) and np.count_nonzero(self.tilt_deg) < 2
        )
        return alike and bool(one_kind or self.reverse != other.reverse)


@dataclass(frozen=True)
class Row:
    """One surface of a file, the object first and the image last; `axes` makes it a coordinate break.

    `shape` holds what a design file says of its shape beside radius and conic constant. `automatic_mm` is a
    semi-diameter that the other program computed from its rays: it clips nothing.
    """

    name: str
    where: str
    radius_mm: float | None = None
    conic: float = 0.0
    shape: dict[str, Any] = field(default_factory=dict)
    thickness_mm: float = 0.0
    material: str | float | None = None
    semi_diameter_mm: float | None = None
    stop: bool = False
    axes: Break | None = None
    automatic_mm: float | None = None


@dataclass
class Draft:
    """A file as read, before it is a lens.

    `aperture` is a kind and its value: object_na, image_na, pupil_diameter_mm, image_f_number (focal length
    over entrance pupil), working_f_number, or stop (whose semi-diameter counts then, not the value).
    `recorded` holds the same surfaces once more, read independently of `rows`: the lens that comes of the
    rows is compared with them.
    """

    source: str
    title: str = ""
    wavelengths_um: list[float] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    recorded: list[RecordedSurface] = field(default_factory=list)
    aperture: tuple[str, float] | None = None
    half_field_mm: float | None = None
    notes: dict[str, Any] = field(default_factory=dict)
    dropped: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def lose(self, what: str) -> None:
        """List something that a design cannot hold, once."""
        if what not in self.dropped:
            self.dropped.append(what)

    def remark(self, what: str) -> None:
        """Say something of the import that loses nothing, once."""
        if what not in self.remarks:
            self.remarks.append(what)

    def lose_ends(self) -> None:
        """List what object and image are beyond planes in air."""
        for row, what in zip((self.rows[0], self.rows[-1]), ("object", "image"), strict=True):
            if row.radius_mm is not None:
                self.lose(f"{row.name}: curved {what} surface")
        if self.rows[0].material is not None:
            self.lose(f"{self.rows[0].name}: object in {self.rows[0].material}, read as air")

    def take_heights(self, x_mm: Sequence[float], y_mm: Sequence[float]) -> None:
        """The field reaches to the highest of these object points; none is no field."""
        pairs = zip_longest(x_mm, y_mm, fillvalue=0.0)
        self.half_field_mm = max((math.hypot(*pair) for pair in pairs), default=None)


def read_lines(path: str | os.PathLike[str]) -> list[str]:
    """Lines of a text file in UTF-8, UTF-16 (with or without a byte order mark) or Latin-1.

    Raises
    ------
    InputError
        If the file cannot be read, is larger than 20 MB, or is no text.
    """
    text = _decode(read_input(path, LENS_FILE_BYTES), str(path))
    if "\0" in text:
        raise InputError(f"cannot read {path}: not a text file")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def _decode(data: bytes, where: str) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or data[1:2] == b"\0":
        marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        try:
            return data.decode("utf-16" if marked else "utf-16-le")
        except UnicodeDecodeError as error:
            raise InputError(
                f"cannot read {where}: not valid UTF-16 text, as its first bytes promise"
            ) from error
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def number(text: str, where: str) -> float:
    """A finite number as other programs write it, or an InputError that says where there is none."""
    value = math.nan
    if len(text) <= 400 and _NUMBER.fullmatch(text):
        value = float(text.lower().replace("d", "e"))
    if not math.isfinite(value):
        raise InputError(f"{where}: {shown(text)} stands where a finite number must")
    return value


class Reader(Protocol):
    """What reads the lines of one file."""

    draft: Draft
    heights: dict[str, list[float]]


def heights_of(axis: str) -> Callable[[Reader, list[str], str], None]:
    """What takes the field heights along one axis."""

    def take(reader: Reader, values: list[str], where: str) -> None:
        reader.heights[axis] = [number(v, where) for v in values]

    return take


def lose_vignetting(reader: Reader, values: list[str], where: str) -> None:
    """Vignetting factors are lost where they are not 0."""
    if any(number(v, where) for v in values):
        reader.draft.lose("vignetting factors")


def shown(text: str) -> str:
    """A piece of a file for a message."""
    return repr(text if len(text) <= 40 else text[:37] + "...")


def note_lines(lens: Lens, pose: Pose, folder: Path) -> list[str]:
    """A design's own data, a remark each: what :func:`read_note` takes back."""
    notes: dict[str, Any] = {
        "title": lens.title,
        "pixel_pitch_um": lens.sensor.pixel_pitch_um,
        "pixels": lens.sensor.pixels,
        "plane_distances_mm": lens.sensor.plane_distances_mm,
        "working_distance_mm": lens.object.working_distance_mm,
        "materials": [s.material if isinstance(s.material, str) else None for s in lens.surfaces],
        "aperture": [lens.object.numerical_aperture, lens.stop_semi_diameter_mm],
    }
    if lens.glass_catalogs:
        notes["glass_catalogs"] = [os.path.relpath(c, folder.resolve()) for c in lens.glass_catalogs]
    if lens.edges:
        notes["edges"] = [edge.model_dump(mode="json", exclude_none=True) for edge in lens.edges]
    if pose != Pose():
        notes["pose"] = asdict(pose)
    return [f"{NOTE} {key} {json.dumps(value)}" for key, value in notes.items()]


def read_note(text: str, draft: Draft, where: str) -> None:
    """Take a remark of :func:`note_lines` into the draft; one that cannot be read is listed as lost."""
    word, key, value = (*text.split(maxsplit=2), "", "", "")[:3]
    if word != NOTE:
        return
    try:
        draft.notes[key] = json.loads(value)
    except (ValueError, RecursionError) as error:  # cut short or folded by the program that saved it
        reason = str(error) if len(str(error)) < 80 else type(error).__name__
        draft.dropped.append(
            f"remark {NOTE} {shown(key)} ({where.rpartition(', ')[2]}): not readable: {reason}"
        )


def writable(lens: Lens, pose: Pose, held: Callable[[Shape], object], kind: str) -> None:
    """Refuse what a sequential file cannot hold.

    Raises
    ------
    InputError
        For a measured figure, a shape that `held` refuses, or a pose of several trials.
    """
    for i, surface in enumerate(lens.surfaces, start=1):
        if surface.figure is not None:
            raise InputError(
                f"surface {i}: {kind} cannot hold a measured figure; leave it out of the design first"
            )
        try:
            held(surface.shape)
        except InputError as error:
            raise InputError(f"surface {i}: {error}") from error
    if any(np.ndim(getattr(pose, f.name)) for f in fields(pose)):
        raise InputError(f"{kind} holds one pose, not one for each trial")


def pose_distances(lens: Lens, pose: Pose) -> tuple[float, float, float, float]:
    """Distances from object to pivot, pivot to front vertex, exit vertex to pivot, pivot to first plane.

    The first and the last run along the axis of object and sensor, the others along that of the lens.
    """
    pivot, despace = float(np.asarray(pose.pivot_z_mm)), float(np.asarray(pose.despace_mm))
    exit_z = lens.exit_vertex_z_mm
    first = lens.sensor.plane_distances_mm[0]
    to_pivot = lens.object.working_distance_mm + despace + pivot
    return to_pivot, -pivot, pivot - exit_z, exit_z + first - pivot - despace


def pose_break(pose: Pose) -> Break:
    """The pose's decenter and tilts as a change of axes at its pivot."""
    x, y, a, b = (
        float(np.asarray(v))
        for v in (pose.decenter_x_mm, pose.decenter_y_mm, pose.tilt_x_deg, pose.tilt_y_deg)
    )
    return Break((x, y), (a, b, 0.0))


def same_name(name: str) -> str:
    """Letters and digits of a glass name: programs spell the rest differently."""
    return "".join(c for c in name.casefold() if c.isalnum())


def find_glass(
    name: str,
    makers: Iterable[str],
    catalogs: Sequence[Path],
    where: str,
    remark: Callable[[str], None] = lambda _: None,
) -> str:
    """The design file's name of a glass: as a user's own catalogue has it, else as the makers have it.

    Parameters
    ----------
    name
        As the file spells it; where no glass has that very name, one with the same letters and digits, if the
        catalogue has only one such.
    makers
        Catalogues that the file names, in their order.
    catalogs
        The user's own catalogue files. They are sought before all makers, those that the file names first.
    remark
        Called with a sentence where the user should know which glass was taken.

    Raises
    ------
    MaterialError
        If no such glass is known; glasses are never guessed.
    """
    listed = list_glasses(catalogs)
    own = list(dict.fromkeys(path.name for path in catalogs))
    known: dict[str, str] = {}
    for _, catalog in listed:
        known.setdefault(catalog.casefold().removesuffix(".agf"), catalog)
    named = [known[key] for maker in makers if (key := maker.casefold().removesuffix(".agf")) in known]
    for catalog in dict.fromkeys([*(c for c in named if c in own), *own, *named]):
        alike = [n for n, c in listed if c == catalog and same_name(n) == same_name(name)]
        exact = [n for n in alike if n.casefold() == name.casefold()] or alike
        if len(exact) == 1:
            found = _shortest_name(exact[0], catalog, catalogs)
            if catalog in own:
                others = {c for n, c in listed if c not in own and same_name(n) == same_name(name)}
                if others:
                    remark(f"glass {name} is that of {catalog}, not of {' or '.join(sorted(others))}")
            _remark_notes(found, catalogs, remark)
            return found
    try:
        get_material(name, catalogs)
    except MaterialError as error:
        raise MaterialError(f"{where}: {error}") from error
    return name


def _remark_notes(name: str, catalogs: Sequence[Path], remark: Callable[[str], None]) -> None:
    try:
        for note in get_material(name, catalogs).notes:
            remark(note)
    except MaterialError:  # said where its index is needed
        pass


def _shortest_name(name: str, maker: str, catalogs: Sequence[Path]) -> str:
    try:
        if get_material(name, catalogs).catalog == maker:
            return name
    except MaterialError:  # one name, two materials; or a glass with a fault
        pass
    return f"{maker}:{name}"
