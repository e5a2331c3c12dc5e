"""A study file to begin with."""

from __future__ import annotations

import os
from pathlib import Path

from lensdesign.errors import atomic_path
from lensdesign.files.design import load_design
from tolerancing.perturbations.grades import starting_study


def start_study(
    design: str | os.PathLike[str], path: str | os.PathLike[str], grade: str = "precision"
) -> None:
    """Write a study of a design with usual tolerances of a grade, to be edited.

    Parameters
    ----------
    design
        The design file.
    path
        The study file to write; what stands there is replaced. It names the design relative to its folder.
    grade
        One of :data:`tolerancing.perturbations.grades.GRADES`.

    Raises
    ------
    InputError
        As of :func:`tolerancing.perturbations.grades.starting_study`; also if a file cannot be read or
        written.
    """
    name = Path(os.path.relpath(Path(design).resolve(), Path(path).resolve().parent)).as_posix()
    text = starting_study(load_design(design), name, grade)
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")
