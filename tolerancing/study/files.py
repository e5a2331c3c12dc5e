"""Study files (TOML): reading them, with the design and the other files that they name."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from lensdesign.common.input_files import TABLE_BYTES, allowed_folder, files_from, read_input, validate_inside
from lensdesign.common.section import Section
from lensdesign.common.toml_files import joined_faults, read_toml, validate
from lensdesign.errors import DesignError, InputError, atomic_path
from lensdesign.files.design import load_design
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import Merit
from tolerancing.merits.compensators import Compensator
from tolerancing.merits.registry import merit_from_table
from tolerancing.perturbations import draws
from tolerancing.perturbations.dependence import Correlation
from tolerancing.perturbations.parameters import Perturbation, perturbation_from_table
from tolerancing.study.lengths import doubted_study_lengths
from tolerancing.study.slice_counts import SliceCounts
from tolerancing.study.study import Study
from tolerancing.study.sweep import ParameterGrid, Sweep

LONGEST_NAME = 255
"""Most bytes of one name in a path, as file systems have it."""

DEEPEST_PATH = 32
"""Most names in the path of a file that a store holds."""


class Checked(Protocol):
    """Whatever can tell that it does not fit a lens."""

    def check(self, lens: Lens) -> None:
        """Refuse it, with a ValueError."""


@dataclass(frozen=True)
class LoadedStudy:
    """A study together with its lens and the files that both came from.

    Attributes
    ----------
    study, lens
        What the files say.
    name : str
        Of the study file among `files`.
    files : mapping of str to bytes
        All files that scores depend on, by paths relative to one folder: study, design, glass catalogues,
        measured surfaces, measured deviations, merits in Python.
    """

    study: Study
    lens: Lens
    name: str
    files: Mapping[str, bytes]

    @cached_property
    def fingerprint(self) -> str:
        """Digest of all that scores depend on: files, refractive indices, how trials are drawn."""
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
        """The study file."""
        return self.files[self.name].decode("utf-8")

    @property
    def design_text(self) -> str:
        """The design file."""
        return self.files[relative(PurePosixPath(self.name).parent / self.study.design)].decode("utf-8")


def load_study(path: str | os.PathLike[str]) -> LoadedStudy:
    """Read a study file, its design, and what both name.

    Parameters
    ----------
    path
        A TOML file.

    Raises
    ------
    DesignError
        If a file cannot be read or does not describe a study of its design; the message names file,
        key, value and what is allowed.
    """
    path = Path(path)
    study = study_from_tables(read_toml(path), str(path), path.parent)
    design = path.parent / study.design
    if allowed_folder() is not None:  # of a store: its own, not a design of the reader
        validate_inside(design, path, "design", DesignError)
    lens = load_design(design)
    # A length in another unit often is the cause of other faults: it comes first.
    _refuse([*doubted_study_lengths(study, lens), *_faults_against(study, lens)], str(path))
    return LoadedStudy(study, lens, *_gathered(path, design, study, lens))


def save_study(study: Study, path: str | os.PathLike[str]) -> None:
    """Write a study file, without comments; only what was given stands in it.

    Parameters
    ----------
    study
        The study. Its design and other files are named relative to the folder of `path`.
    path
        A TOML file.

    Raises
    ------
    InputError
        If the file cannot be written; whatever stood there stays.
    """
    import tomli_w

    tables = study.model_dump(mode="json", by_alias=True, exclude_unset=True, exclude_none=True)
    for table, perturbation in zip(tables["perturbation"], study.perturbations, strict=True):
        table |= {"distribution": perturbation.distribution.kind} | table["distribution"]
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(tomli_w.dumps(tables), encoding="utf-8")


def _gathered(path: Path, design: Path, study: Study, lens: Lens) -> tuple[str, dict[str, bytes]]:
    """The study's name, and all files by their paths from the folder that holds them all."""
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
    """A path without steps back."""
    return os.path.normpath(path.as_posix())


def load_from_files(name: str, files: Mapping[str, bytes], folder: Path) -> LoadedStudy:
    """A study from the files that :class:`LoadedStudy` holds.

    Parameters
    ----------
    name, files
        As of :class:`LoadedStudy`.
    folder
        An empty folder into which they are written, and which the lens needs as long as it is used.

    Raises
    ------
    DesignError
        As :func:`load_study`; also if a name is no plain relative path, or leads out of the folder.
    """
    root = folder.resolve()
    for own in (*files, name):
        _check_file_name(own)
    if name not in files:
        raise DesignError(f"study {name!r:.80}: is none of the files that are held")
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
            return load_study(root / name)
    except DesignError as error:
        raise DesignError(str(error).replace(f"{root}{os.sep}", "")) from None


def _check_file_name(name: object) -> None:
    """Refuse a name that is no plain relative path: whoever made a store could have written anything."""
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
        raise DesignError(f"file {name!r:.80}: is no text that a file can be named by") from error
    if longest > LONGEST_NAME or len(parts) > DEEPEST_PATH:
        raise DesignError(
            f"file {name!r:.80}: at most {DEEPEST_PATH} names of at most {LONGEST_NAME} bytes are allowed"
        )


def study_from_tables(data: dict[str, Any], source: str, folder: Path | None = None) -> Study:
    """A study from the tables of its file, all faults in one DesignError.

    Parameters
    ----------
    data
        The tables.
    source
        What to call the study in messages.
    folder
        Folder of the study, from which the files of distributions and merits are read at once. Without it
        the study names no files that can be read.
    """
    faults: list[str] = []
    data = dict(data)
    readers: dict[str, Callable[[dict[str, Any], str], Section]] = {
        "perturbation": perturbation_from_table,
        "merit": merit_from_table,
        "sweep": lambda table, where: validate(Sweep, table, where),
        "grid": lambda table, where: validate(ParameterGrid, table, where),
        "slice_count": lambda table, where: validate(SliceCounts, table, where),
        "correlation": lambda table, where: validate(Correlation, table, where),
        "compensator": lambda table, where: validate(Compensator, table, where),
    }
    for key, reader in readers.items():
        tables = data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise DesignError(f"{source}: {key}: must be tables, each headed [[{key}]]")
        items = []
        for number, table in enumerate(tables, start=1):
            where = f"{source}: {key} {number}"
            try:
                item = reader(table, where)
                items.append(item if folder is None else _with_its_file(item, folder, source, where))
            except InputError as error:
                told = str(error)
                faults.append(told if told.startswith(f"{source}: ") else f"{where}: {told}")
        if key in data:
            data[key] = tuple(items)
    if faults:
        raise DesignError(joined_faults(faults))
    return validate(Study, data, source)


def _with_its_file(item: Section, folder: Path, source: str, where: str) -> Section:
    """A perturbation or merit with what its own file holds; another section as it is."""
    if not isinstance(item, Perturbation | Merit):
        return item
    if item.file_name is not None:
        validate_inside(
            folder / item.file_name, folder / Path(source).name, where.removeprefix(f"{source}: ")
        )
    return item.loaded(folder)


def check_against(study: Study, lens: Lens, source: str) -> None:
    """Refuse what this lens does not have, with all faults in one DesignError."""
    _refuse(_faults_against(study, lens), source)


def _refuse(faults: Sequence[str], source: str) -> None:
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
    """Parameters that are varied and that a merit which scores them cannot follow."""
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


def _faults(items: Iterable[Checked], key: str, lens: Lens) -> list[str]:
    faults = []
    for number, item in enumerate(items, start=1):
        try:
            item.check(lens)
        except ValueError as error:
            faults.append(f"{key} {number}: {error}")
    return faults
