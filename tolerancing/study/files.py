"""Study files (TOML): reading and writing them, together with the design and other files that they name."""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from lensdesign.common.atomic_files import atomic_path
from lensdesign.common.consent import trust_user_code
from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.given import FilePath, object_of
from lensdesign.common.input_files import TABLE_BYTES, allowed_folder, files_from, read_input, validate_inside
from lensdesign.common.text import printable_name
from lensdesign.common.toml_files import joined_faults, read_toml, validate
from lensdesign.errors import DesignError, InputError
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations import draws
from tolerancing.perturbations.dependence import Correlation
from tolerancing.perturbations.parameters import Perturbation, perturbation_from_table
from tolerancing.study.lengths import implausible_study_lengths
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.study import Study
from tolerancing.study.sweep import ParameterGrid, Sweep


class LensCheckable(Protocol):
    """A section of a study that can be checked against a lens."""

    def check(self, lens: Lens) -> None:
        """Raise a ValueError if the section does not fit the lens."""


@dataclass(frozen=True)
class LoadedStudy:
    """A study together with its lens and the files from which both were read.

    Attributes
    ----------
    study : Study
        The study.
    lens : Lens
        The nominal lens.
    name : str
        Key of the study file in `files`.
    files : mapping of str to bytes
        Contents of all files on which scores depend: study, design, glass catalogues, measured surfaces,
        measured deviations, user-defined merits. The keys are paths relative to their common folder.

    Examples
    --------
    >>> from tolerancing import load_study
    >>> loaded = load_study("designs/as_built_tolerances.toml")
    >>> loaded.lens.half_field_mm, sorted(loaded.files)
    (1.5, ['as_built_tolerances.toml', 'paper_singlet.toml'])
    """

    study: Study
    lens: Lens
    name: str
    files: Mapping[str, bytes]

    @cached_property
    def fingerprint(self) -> str:
        """Digest of everything that scores depend on: files, refractive indices, sampling of trials."""
        digest = hashlib.sha256(self.name.encode())
        for name, content in sorted(self.files.items()):
            digest.update(f"\0{name}\0{len(content)}\0".encode() + content)
        indices = [self.lens.indices(w).tolist() for w in self.lens.wavelengths_um]
        digest.update(repr(indices).encode())
        if self.study.draws != "random":
            digest.update(f"\0{draws.REPLICATES} designs".encode())
        return digest.hexdigest()

    @property
    def study_text(self) -> str:
        """Text of the study file."""
        return self.files[self.name].decode("utf-8")

    @property
    def design_text(self) -> str:
        """Text of the design file."""
        return self.files[relative(PurePosixPath(self.name).parent / self.study.design)].decode("utf-8")


def load_study(path: str | os.PathLike[str], *, trust: bool = False) -> LoadedStudy:
    """Read a study file, its design, and the other files to which both refer.

    Parameters
    ----------
    path
        Study file (TOML).
    trust
        Whether the code of its Python merits may be executed. If False, scoring a lens by such a merit raises
        an InputError, unless the study is read within :func:`lensdesign.trust_user_code`. Reading executes
        no code.

    Returns
    -------
    LoadedStudy
        The study with its lens and files.

    Raises
    ------
    DesignError
        If a file cannot be read or does not describe a study of its design. The message names file, key,
        value and what is allowed.

    Examples
    --------
    >>> from tolerancing import load_study
    >>> study = load_study("designs/paper_tolerances.toml").study
    >>> study.trials, [merit.label for merit in study.merits]
    (500, ['contrast_0p775um', 'contrast_1p55um', 'strehl', 'largest_spread_deg'])
    """
    path = Path(path)
    with trust_user_code(trust):
        study = study_from_tables(read_toml(path), str(path), path.parent)
    design = path.parent / study.design
    if allowed_folder() is not None:  # a study inside a store must not read other designs
        validate_inside(design, path, "design", DesignError)
    lens = load_design(design)
    # A length in another unit is often the cause of other faults, so it comes first.
    _raise_faults([*implausible_study_lengths(study, lens), *_faults_against(study, lens)], str(path))
    return LoadedStudy(study, lens, *_gathered(path, design, study, lens))


def save_study(study: Study, path: str | os.PathLike[str]) -> None:
    """Write a study file, without comments and without default values.

    Parameters
    ----------
    study
        The study. Its paths of the design and other files are written unchanged and are read relative to the
        folder of `path`.
    path
        File to write (TOML).

    Raises
    ------
    InputError
        If the file cannot be written. An existing file then stays as it is.

    Examples
    --------
    >>> from tolerancing import load_study, save_study
    >>> quick = load_study("designs/as_built_tolerances.toml").study.replaced(trials=100, sensitivity=False)
    >>> save_study(quick, "designs/quick_tolerances.toml")
    >>> load_study("designs/quick_tolerances.toml").study == quick
    True
    """
    import tomli_w

    tables = study.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude_none=True)
    for table, perturbation in zip(tables["perturbation"], study.perturbations, strict=True):
        table |= {"distribution": perturbation.distribution.kind} | table["distribution"]
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(tomli_w.dumps(tables), encoding="utf-8")


def _gathered(path: Path, design: Path, study: Study, lens: Lens) -> tuple[str, dict[str, bytes]]:
    """Return the path of the study file and the contents of all files, relative to their common folder."""
    named = [p.file_name for p in study.perturbations] + [m.file_name for m in study.all_merits]
    figures = [s.figure.file for s in lens.surfaces if s.figure is not None and s.figure.file is not None]
    paths = [path, design, *lens.glass_catalogs, *figures, *(path.parent / n for n in named if n is not None)]
    absolute = {p: Path(os.path.abspath(p)) for p in paths}
    root = Path(os.path.commonpath([p.parent for p in absolute.values()]))
    files = {}
    for own in absolute.values():
        name = own.relative_to(root).as_posix()
        _check_file_name(name)
        files[name] = read_input(own, TABLE_BYTES, DesignError)
    return absolute[path].relative_to(root).as_posix(), files


def relative(path: PurePosixPath) -> str:
    """Return a path without ``..`` steps."""
    return os.path.normpath(path.as_posix())


def load_from_files(
    name: str, files: Mapping[str, bytes], folder: Path, *, trust: bool = False
) -> LoadedStudy:
    """Load a study from the contents of its files.

    Parameters
    ----------
    name
        Path of the study file among `files`.
    files : mapping of str to bytes
        Contents of all files, by relative paths.
    folder
        An empty folder for the files. The lens needs it as long as the lens is used.
    trust
        Whether the code of Python merits may be executed; see :func:`load_study`.

    Raises
    ------
    DesignError
        If the files do not describe a study, if a path is not a plain relative path, or if a path leads out
        of the folder.
    """
    root = folder.resolve()
    for own in (*files, name):
        _check_file_name(own)
    if name not in files:
        raise DesignError(f"study {name!r:.80}: is missing among the files of the store")
    for own, content in files.items():
        target = root / own
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(content)
        except (FileExistsError, NotADirectoryError, IsADirectoryError) as error:
            raise DesignError(f"file {own!r:.80}: is named as a file and as a folder") from error
        except OSError as error:
            raise DesignError(f"file {own!r:.80}: cannot be unpacked: {error.strerror or error}") from error
    try:
        with files_from(root):
            return load_study(root / name, trust=trust)
    except DesignError as error:
        raise DesignError(str(error).replace(f"{root}{os.sep}", "")) from None


def _check_file_name(name: object) -> None:
    """Raise a DesignError unless a name is a plain relative path; stores of others are not trusted."""
    longest_name, deepest_path = 255, 32  # bytes of a name (limit of file systems), names of a path
    if not isinstance(name, str):
        raise DesignError(f"file {name!r:.80}: its name must be text")
    parts = name.split("/")
    if name.startswith("/") or ".." in parts:
        raise DesignError(f"file {name!r:.80}: leads out of the study's folder")
    if any(part in ("", ".") for part in parts) or any(ord(c) < 32 or ord(c) == 127 for c in name):
        raise DesignError(
            f"file {name!r:.80}: must be a relative path of plain names, as in 'parts/lens.toml'"
        )
    try:
        longest = max(len(part.encode()) for part in parts)
    except UnicodeEncodeError as error:
        raise DesignError(f"file {name!r:.80}: cannot be the name of a file") from error
    if longest > longest_name or len(parts) > deepest_path:
        raise DesignError(
            f"file {name!r:.80}: at most {deepest_path} names of at most {longest_name} bytes are allowed"
        )


def study_from_tables(data: dict[str, Any], source: str, folder: Path | None = None) -> Study:
    """Return a study from the tables of its file.

    Parameters
    ----------
    data
        Tables of the file.
    source
        Name of the study in messages.
    folder
        Folder of the study, from which the files of distributions and merits are read; default: these files
        are not read.

    Raises
    ------
    DesignError
        If a key or value is not allowed. The message lists every fault.
    """
    faults: list[str] = []
    data = dict(data)
    readers: dict[str, Callable[[dict[str, Any], str], FrozenModel]] = {
        "perturbation": perturbation_from_table,
        "merit": merit_from_table,
        "sweep": lambda table, location: validate(Sweep, table, location),
        "grid": lambda table, location: validate(ParameterGrid, table, location),
        "slice_count": lambda table, location: validate(SliceCounts, table, location),
        "correlation": lambda table, location: validate(Correlation, table, location),
        "compensator": lambda table, location: validate(Compensator, table, location),
    }
    for key, reader in readers.items():
        tables = data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise DesignError(f"{source}: {key}: must be tables, each headed [[{key}]]")
        items = []
        for number, table in enumerate(tables, start=1):
            location = f"{source}: {key} {number}"
            try:
                item = reader(table, location)
                items.append(item if folder is None else _with_its_file(item, folder, source, location))
            except InputError as error:
                message = str(error)
                faults.append(message if message.startswith(f"{source}: ") else f"{location}: {message}")
        if key in data:
            data[key] = tuple(items)
    if faults:
        raise DesignError(joined_faults(faults))
    return validate(Study, data, source)


def _with_its_file(item: FrozenModel, folder: Path, source: str, location: str) -> FrozenModel:
    """Return a perturbation or merit with the data of its file; other sections are returned unchanged."""
    if not isinstance(item, Perturbation | Merit):
        return item
    if item.file_name is not None:
        validate_inside(
            folder / item.file_name, folder / Path(source).name, location.removeprefix(f"{source}: ")
        )
    return item.loaded(folder)


def start_study(
    design: str | os.PathLike[str],
    path: str | os.PathLike[str],
    grade: str = "precision",
    calibrated: bool = True,
) -> None:
    """Write a study of a design with the usual tolerances of a manufacturing grade, as a file to edit.

    Parameters
    ----------
    design
        The design file.
    path
        The study file to write; an existing file is replaced. It names the design relative to its folder.
    grade
        ``commercial``, ``precision``, ``high_precision``, ``moulded_glass``, ``moulded_plastic``, or
        ``iso10110`` for the general tolerances of ISO 10110-11, which depend on the size of a part.
    calibrated
        Whether decenter and tilt of the lens are calibrated before a reconstruction; the study then has
        compensators for them. Otherwise reconstructions assume the nominal mounting.

    Raises
    ------
    InputError
        If a file cannot be read or written, if the grade is unknown, or if a part is larger than the table of
        the standard covers.

    Examples
    --------
    >>> from tolerancing import load_study, start_study
    >>> start_study("designs/paper_singlet.toml", "shop.toml", grade="commercial")
    >>> study = load_study("shop.toml").study
    >>> study.title, study.perturbations[0].tolerance
    ('Spatial information transfer lens, Table 1: commercial grade', 0.1)
    """
    from tolerancing.perturbations.grades import starting_study

    name = Path(os.path.relpath(Path(design).resolve(), Path(path).resolve().parent)).as_posix()
    if (shown := printable_name(name)) != name:
        raise InputError(f"{shown}: its name is not UTF-8, so a study cannot state it; rename it")
    text = starting_study(load_design(design), name, grade, calibrated)
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")


def lens_and_study(lens: Lens | FilePath, study: Study | LoadedStudy | FilePath) -> tuple[Lens, Study]:
    """Return a lens and a study, each given as an object or as the path of its file.

    Raises
    ------
    InputError
        If one is neither, or a file cannot be read.
    """
    found = object_of(lens, Lens, load_design, "lens")
    if isinstance(study, LoadedStudy):
        return found, study.study
    return found, object_of(study, Study, lambda path: load_study(path).study, "study")


def study_by_name(name: str, lens: Lens) -> Study:
    """Return the study of a grade for a lens, as :func:`start_study` writes it, or that of a study file.

    Parameters
    ----------
    name
        A grade, or the path of a study, whose own design is ignored.
    lens
        The lens.

    Raises
    ------
    InputError
        If it is neither, or the lens lacks surfaces or elements that the study perturbs.
    """
    from tolerancing.perturbations.grades import GRADES, starting_study

    if name in GRADES:
        return study_from_tables(tomllib.loads(starting_study(lens, "design.toml", name)), name)
    if not os.path.exists(name):
        raise InputError(f"{name!r}: no grade of tolerances ({', '.join(GRADES)}), and no such study file")
    study = load_study(name).study
    check_against(study, lens, name)
    return study


def check_against(study: Study, lens: Lens, source: str) -> None:
    """Raise a DesignError that lists everything of the study that does not fit the lens."""
    _raise_faults(_faults_against(study, lens), source)


def _raise_faults(faults: Sequence[str], source: str) -> None:
    if faults:
        raise DesignError(joined_faults([f"{source}: {fault}" for fault in faults]))


def _faults_against(study: Study, lens: Lens) -> list[str]:
    return [
        *_faults(study.perturbations, "perturbation", lens),
        *_faults(study.all_merits, "merit", lens),
        *_faults(study.compensators, "compensator", lens),
        *_faults(study.sweeps, "sweep", lens),
        *_faults(study.grids, "grid", lens),
        *_faults(study.slice_counts, "slice_count", lens),
        *_faults_of_merits(study),
    ]


def _faults_of_merits(study: Study) -> list[str]:
    """Return the faults of varied parameters that a merit cannot score."""
    faults = dict[str, None]()
    every = {merit.label for merit in study.all_merits}
    scored = [(p, every) for p in (*study.perturbations, *study.compensators)]
    scored += [(sweep, set(sweep.merits)) for sweep in study.sweeps]
    scored += [(axis, set(grid.merits)) for grid in study.grids for axis in (grid.x, grid.y)]
    for parameter, labels in scored:
        for merit in study.all_merits:
            if merit.label in labels:
                try:
                    merit.check_perturbation(parameter)
                except ValueError as error:
                    faults[f"merit {merit.label!r}: {error}"] = None
    return list(faults)


def _faults(items: Iterable[LensCheckable], key: str, lens: Lens) -> list[str]:
    faults = []
    for number, item in enumerate(items, start=1):
        try:
            item.check(lens)
        except ValueError as error:
            faults.append(f"{key} {number}: {error}")
    return faults
