"""Study files (TOML): which lens, what scatters, what is judged, what is swept."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, SerializeAsAny, field_validator, model_validator

from lensdesign.errors import DesignError
from lensdesign.files import load_design, read_text, read_toml, validate
from lensdesign.system import Finite, Lens, Section
from tolerancing.context import Sampling
from tolerancing.merit import Merit
from tolerancing.merits import merit_from_table
from tolerancing.perturbations import Perturbation, PerturbedParameter, perturbation_from_table
from tolerancing.sweep import Sweep

MOST_TRIALS = 10_000_000

RESERVED_COLUMNS = ("trial", "status", "message", "passed")


class Study(Section):
    """A tolerance study; the study file, in memory.

    Attributes
    ----------
    title
        What to call it.
    design
        Design file of the lens, relative to the study file.
    trials
        Number of Monte Carlo trials.
    seed
        Seed of all randomness.
    pivot_z_mm
        Where on the axis the whole lens turns, from its front vertex.
    sampling
        How finely merits are sampled.
    perturbations
        What scatters; the ``[[perturbation]]`` tables.
    merits
        What is judged; the ``[[merit]]`` tables.
    sweeps
        What is varied by itself; the ``[[sweep]]`` tables.
    """

    title: str = ""
    design: str
    trials: Annotated[int, Field(ge=1, le=MOST_TRIALS)]
    seed: Annotated[int, Field(ge=0)]
    pivot_z_mm: Finite = 0.0
    sampling: Sampling = Sampling()
    perturbations: Annotated[
        tuple[SerializeAsAny[Perturbation], ...], Field(alias="perturbation", min_length=1)
    ]
    merits: Annotated[tuple[SerializeAsAny[Merit], ...], Field(alias="merit", min_length=1)]
    sweeps: tuple[Sweep, ...] = Field(default=(), alias="sweep")

    @field_validator("perturbations")
    @classmethod
    def _distinct_columns(cls, value: tuple[Perturbation, ...]) -> tuple[Perturbation, ...]:
        refuse_repeated([p.column for p in value], "two perturbations")
        return value

    @field_validator("sweeps")
    @classmethod
    def _distinct_sweeps(cls, value: tuple[Sweep, ...]) -> tuple[Sweep, ...]:
        refuse_repeated([s.label for s in value], "two sweeps")
        return value

    @model_validator(mode="after")
    def _consistent(self) -> Study:
        refuse_repeated([m.label for m in self.merits], "two merits")
        columns = [
            *RESERVED_COLUMNS,
            *(p.column for p in self.perturbations),
            *(m.column for m in self.merits),
        ]
        refuse_repeated(columns, "a perturbation or merit and another column")
        labels = [m.label for m in self.merits]
        for sweep in self.sweeps:
            for label in sweep.merits:
                if label not in labels:
                    raise ValueError(
                        f"sweep {sweep.label!r}: merits: there is no merit {label!r}; "
                        f"allowed: {', '.join(labels)}"
                    )
        return self

    def sweep_merits(self, sweep: Sweep) -> tuple[Merit, ...]:
        """All that a sweep scores: the study's merits that it names, and its line pairs."""
        return (*(m for m in self.merits if m.label in sweep.merits), *sweep.line_pairs())


@dataclass(frozen=True)
class LoadedStudy:
    """A study together with its lens and the texts that both came from.

    Attributes
    ----------
    study, lens
        What the files say.
    study_text, design_text
        The files themselves.
    """

    study: Study
    lens: Lens
    study_text: str
    design_text: str

    @property
    def fingerprint(self) -> str:
        """Digest of all that scores depend on: both texts, and the lens's refractive indices."""
        indices = [self.lens.indices(w).tolist() for w in self.lens.wavelengths_um]
        parts = "\0".join([self.study_text, self.design_text, repr(indices)])
        return hashlib.sha256(parts.encode()).hexdigest()


def load_study(path: str | os.PathLike[str]) -> LoadedStudy:
    """Read a study file and its design.

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
    study = study_from_tables(read_toml(path), str(path))
    design = path.parent / study.design
    lens = load_design(design)
    check_against(study, lens, str(path))
    return LoadedStudy(study, lens, read_text(path), read_text(design))


def study_from_tables(data: dict[str, Any], source: str) -> Study:
    """A study from the tables of its file, all faults in one DesignError."""
    faults: list[str] = []
    data = dict(data)
    readers: dict[str, Callable[[dict[str, Any], str], Section]] = {
        "perturbation": perturbation_from_table,
        "merit": merit_from_table,
        "sweep": lambda table, where: validate(Sweep, table, where),
    }
    for key, reader in readers.items():
        tables = data.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise DesignError(f"{source}: {key}: must be tables, each headed [[{key}]]")
        items = []
        for number, table in enumerate(tables, start=1):
            try:
                items.append(reader(table, f"{source}: {key} {number}"))
            except DesignError as error:
                faults.append(str(error))
        if key in data:
            data[key] = tuple(items)
    if faults:
        raise DesignError("\n".join(faults))
    return validate(Study, data, source)


def check_against(study: Study, lens: Lens, source: str) -> None:
    """Refuse what this lens does not have, with all faults in one DesignError."""
    faults = [
        *_faults(study.perturbations, "perturbation", lens),
        *_faults(study.merits, "merit", lens),
        *_faults(study.sweeps, "sweep", lens),
    ]
    if faults:
        raise DesignError("\n".join(f"{source}: {fault}" for fault in faults))


def _faults(items: Iterable[Merit | PerturbedParameter], key: str, lens: Lens) -> list[str]:
    faults = []
    for number, item in enumerate(items, start=1):
        try:
            item.check(lens)
        except ValueError as error:
            faults.append(f"{key} {number}: {error}")
    return faults


def refuse_repeated(names: Iterable[str], what: str) -> None:
    """Refuse a name that stands twice, with a ValueError."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f"{what} are both called {name!r}; give one of them another name")
        seen.add(name)
