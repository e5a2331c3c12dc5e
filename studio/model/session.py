"""Settings and results of the tabs. They belong to the document, so that they outlive a page."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from lensdesign.lens.lens import Lens
from studio.model.jobs import Job
from studio.model.searches import GOALS, SENSOR_LIMITS, Search, variables_of
from tolerancing.study.study import Study


@dataclass(eq=False)
class SearchRun:
    """A search and the lens from which it started."""

    job: Job
    start: Lens


@dataclass(eq=False)
class ExplorationRun:
    """An exploration and the names of its two objectives."""

    job: Job
    over: tuple[str, str]


@dataclass(eq=False)
class StudyRun:
    """A tolerance study, and the folder with its trials, which is removed with this object.

    Attributes
    ----------
    job
        The running study.
    study
        Perturbations and limits.
    storage
        Temporary folder with the study, its lens and its store.
    picked
        Trial whose deviations are those of the what-if; None before the first choice.
    """

    job: Job
    study: Study
    storage: tempfile.TemporaryDirectory[str]
    picked: int | None = None

    @property
    def folder(self) -> Path:
        """Folder of the study."""
        return Path(self.storage.name)


@dataclass(eq=False)
class Session:
    """Settings and results of the tabs.

    Attributes
    ----------
    varied
        Names of the values that a search may change; see :func:`studio.model.searches.variables_of`.
    ranges
        Bounds of these values that the user has changed, by name.
    goal, limits
        Goal of a search, and the texts of its constraints by their keys.
    over, lenses
        Objectives of an exploration, and the approximate number of its lenses.
    trials
        Number of trials of a study.
    search, exploration, study
        The last run of each kind; None before the first.
    exports
        Exports so far.
    opened_folder
        Reading of the last folder of results.
    compared
        Designs to compare, by their names.
    """

    varied: tuple[str, ...]
    ranges: dict[str, tuple[float, ...]] = field(default_factory=dict)
    goal: str = GOALS[0]
    limits: dict[str, str] = field(default_factory=lambda: dict.fromkeys(SENSOR_LIMITS, "sensor"))
    over: tuple[str, str] = ("thickness", "spread")
    lenses: int = 12
    trials: int = 400
    search: SearchRun | None = None
    exploration: ExplorationRun | None = None
    study: StudyRun | None = None
    exports: list[Job] = field(default_factory=list)
    opened_folder: Job | None = None
    compared: dict[str, Lens] = field(default_factory=dict)

    @classmethod
    def of_lens(cls, lens: Lens) -> Session:
        """Return the session of a lens, with its radii and the conic of surface 2 as variables."""
        names = variables_of(lens)
        return cls(tuple(name for name in names if "radius" in name or name == "surface 2 conic"))

    def varied_in(self, lens: Lens) -> tuple[str, ...]:
        """Return the names of the ticked values that a lens has."""
        return tuple(name for name in variables_of(lens) if name in self.varied)

    def requested_search(self, lens: Lens) -> Search:
        """Return the search with these settings.

        Raises
        ------
        InputError
            If no value is ticked, or a limit is not a number.
        """
        return Search.of_texts(self.varied_in(lens), self.goal, self.limits, self.ranges)

    def close(self) -> None:
        """End the running jobs."""
        runs = (self.search, self.exploration, self.study)
        for job in [run.job for run in runs if run is not None] + self.exports:
            job.cancel()
        if self.opened_folder is not None:
            self.opened_folder.cancel()
