"""User-defined merits: a Python function in a file next to the study."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, field_validator

from lensdesign.common.consent import is_user_code_trusted
from lensdesign.errors import DesignError, InputError, TransferLensError
from lensdesign.lens.lens import Lens
from tolerancing.merits.base import LARGEST_SCORE, Merit
from tolerancing.merits.context import Context
from tolerancing.merits.user_code import run_user_code
from tolerancing.perturbations.batch import PerturbationBatch
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    from tolerancing.merits.sensor_rays import Arrival
    from wavesim import ReconstructionPupil


@dataclass(frozen=True, eq=False)
class Trial:
    """A perturbed system, the argument of a user-defined merit.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    state : SystemState
        Pose, surface perturbations, shifts of object and sensor, wavelength.
    deltas : dict of str to float
        Deviations from nominal by the columns of the perturbations, in their units.
    number : int or None
        Number of the trial; None in a sweep.
    """

    lens: Lens
    state: SystemState
    deltas: dict[str, float]
    number: int | None
    _context: Context
    _batch: PerturbationBatch
    _wavelength_um: float | None

    @property
    def placement(self) -> SystemState:
        """Former name of `state`, which merits of earlier versions use."""
        return self.state

    def rays(self, *field_points_mm: tuple[float, float]) -> Arrival:
        """Trace rays from object points through the stop to the sensor; arrays have shape (1, rays, ...)."""
        return self._context.rays(self._batch, field_points_mm, self._wavelength_um)

    def pupil(
        self, field_mm: tuple[float, float] = (0.0, 0.0), *, refocus: bool = True
    ) -> ReconstructionPupil:
        """Return the reconstruction pupil of an object point without lateral shift and, by default, focus."""
        (pupil,) = self._context.pupils(self._batch, field_mm, self._wavelength_um, refocus, True)
        return pupil


class PythonMerit(Merit):
    """A user-defined function.

    Attributes
    ----------
    function
        ``file.py:name``, with the file relative to the study. The function receives a :class:`Trial` and
        returns a number. The trial fails if the function raises, tries to exit, or returns a number that is
        not finite or larger than :data:`LARGEST_SCORE`.
    score_unit
        Unit of the scores, for columns and reports.
    """

    function: str
    score_unit: Annotated[str, Field(pattern=r"^[a-z%_]*$", max_length=20)] = ""

    @property
    def details(self) -> tuple[str, ...]:
        return f"function {self.function}", *super().details

    _source: str = PrivateAttr(default="")
    _is_trusted: bool = PrivateAttr(default=False)
    _failure: str = PrivateAttr(default="")

    @field_validator("function")
    @classmethod
    def _function(cls, value: str) -> str:
        file, _, name = value.rpartition(":")
        if not file.endswith(".py") or not name.isidentifier():
            raise ValueError(f"{value!r}: must be file.py:name, a function in a file next to the study")
        return value

    @property
    def unit(self) -> str:
        return self.score_unit

    @property
    def file_name(self) -> str:
        return self.function.rpartition(":")[0]

    def loaded(self, folder: Path) -> Self:
        from lensdesign.common.toml_files import read_text

        own = self.model_copy()
        own._source = read_text(folder / self.file_name)
        own._is_trusted = is_user_code_trusted()
        return own

    @property
    def lacks_consent(self) -> bool:
        return not self._is_trusted

    def without_user_code(self, reason: str) -> Self:
        own = self.model_copy()
        own._failure = reason
        return own

    def prepare(self) -> None:
        self._runnable()

    def scores(self, context: Context, batch: PerturbationBatch) -> NDArray[np.float64]:
        function = self._runnable()
        systems = context.states(batch, self.wavelength_um)

        def score(trial: Trial) -> float:
            return run_user_code(lambda: _number(function(trial), self.function), self.file_name)

        return np.array(
            [
                score(self._trial(context, one, system))
                for one, system in zip(batch.single_trials(), systems, strict=True)
            ]
        )

    def _runnable(self) -> Any:
        if self._failure:
            raise InputError(self._failure)
        return function_of(self._source, self.function, is_trusted=self._is_trusted)

    def _trial(self, context: Context, one: PerturbationBatch, system: SystemState) -> Trial:
        columns = [p.column for p in one.parameters]
        return Trial(
            lens=context.lens,
            state=system,
            deltas=dict(zip(columns, one.values[0].tolist(), strict=True)),
            number=one.trial_numbers[0] if one.trial_numbers else None,
            _context=context,
            _batch=one,
            _wavelength_um=self.wavelength_um,
        )


def _number(value: Any, function: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{function} returned {type(value).__name__}: must be a number") from None
    except OverflowError:
        number = math.inf
    if math.isnan(number):
        raise InputError(f"{function} returned NaN")
    if abs(number) > LARGEST_SCORE:
        raise InputError(f"{function} returned {number:g}: must lie within +-{LARGEST_SCORE:g}")
    return number


@lru_cache(maxsize=32)
def function_of(source: str, function: str, *, is_trusted: bool) -> Any:
    """Run the text of a file and return one of its functions.

    Nothing else in the toolkit executes Python code of a user.

    Parameters
    ----------
    source
        Text of the file.
    function
        ``file.py:name``.
    is_trusted
        Whether the user allowed the code to be executed; see :func:`lensdesign.trust_user_code`.

    Raises
    ------
    InputError
        If the code is not trusted. The message has the SHA-256 of the file.
    DesignError
        If the text is not valid Python, fails when it runs, or has no such function.
    """
    file, _, name = function.rpartition(":")
    if not is_trusted:
        digest = hashlib.sha256(source.encode()).hexdigest()
        raise InputError(
            f"{file}: scores need this Python code (SHA-256 {digest}), which would have all your rights, so "
            "it was not executed. Read it, and if you trust it: --trust after the command (in Python: "
            "trust=True of load_study or open_store, or `with trust_user_code()`)"
        )
    namespace: dict[str, Any] = {"__name__": Path(file).stem, "__file__": file}
    try:
        run_user_code(lambda: exec(compile(source, file, "exec"), namespace), file)
    except TransferLensError as error:
        raise DesignError(f"{file}: cannot be run: {error}") from error
    found = namespace.get(name)
    if not callable(found):
        raise DesignError(f"{file}: there is no function {name!r}")
    return found
