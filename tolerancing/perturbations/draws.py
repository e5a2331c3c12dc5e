"""Probabilities of the trials: independent draws, Latin hypercubes or Sobol sequences.

Each trial has its own row of probabilities, one for each column of a study. A row depends only on the method,
the seed, the trial's number, the number of columns and, for Latin hypercubes, the number of trials planned.
The result is therefore the same for any worker, any run and any set of other trials.

Designed draws consist of `REPLICATES` independently randomised designs. Trial t belongs to replicate t modulo
`REPLICATES`. The yields of the replicates scatter as they would from study to study, and this scatter gives
the confidence interval of a yield (Owen, Monte Carlo theory, methods and examples, 2013, section 17.5). A
single design gives no such estimate.

Spawn keys separate the random streams of one seed: ``(trial,)`` draws the values of a trial, ``(trial, 1 +
column)`` draws the random figure of one of its columns, and keys of three integers make the designed draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

SMALLEST, LARGEST = 2.0**-54, 1.0 - 2.0**-53
"""Limits of all probabilities. A normal distribution has no quantile of 0 or 1."""

MOST_SOBOL_COLUMNS = 21201
"""Largest dimension with known direction numbers (Joe and Kuo, SIAM J. Sci. Comput. 30, 2635, 2008)."""

SOBOL_BLOCK_VALUES = 2**16

REPLICATES = 16
"""Number of independent designs. More designs estimate their scatter better; fewer designs have more trials
each. With a power of two, each Sobol sequence is a complete net if the number of trials is a power of two."""

MOST_TRIAL = 2**32 - 1
"""Largest trial number. A larger one would need two words of a spawn key and collide with (trial, column)."""


def probabilities(method: str, seed: int, trials: Sequence[int], columns: int, planned: int) -> Array:
    """Return the probabilities of the given trials.

    Parameters
    ----------
    method
        Sampling method, one of `DRAWS`.
    seed
        Seed of the study.
    trials : sequence of int
        Numbers of the trials, counted from 0, in any order.
    columns
        Number of values of a trial.
    planned
        Number of trials of the study. A Latin hypercube has as many strata as a replicate has trials.
        Further trials fill further hypercubes of the same size.

    Returns
    -------
    ndarray, shape (trials, columns)
        Probabilities in the open interval (0, 1).

    Raises
    ------
    InputError
        If the method is unknown, a trial's number is negative or above `MOST_TRIAL`, or a Sobol sequence
        would need more than `MOST_SOBOL_COLUMNS` columns.

    Examples
    --------
    >>> probabilities("random", seed=1, trials=[0, 1], columns=3, planned=2).shape
    (2, 3)
    """
    if method not in DRAWS:
        raise InputError(f"draws = {method!r}: unknown sampling method; allowed: {', '.join(DRAWS)}")
    numbers = np.asarray(trials, dtype=np.int64).reshape(-1)
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() <= MOST_TRIAL:
        raise InputError(f"trial numbers {numbers.min()} to {numbers.max()}: allowed: 0 to {MOST_TRIAL}")
    return _METHODS[method](seed, numbers, columns, planned)


def replicates(method: str, trials: ArrayLike) -> NDArray[np.int64] | None:
    """Return the index of the replicate that each trial belongs to; None if the trials are independent.

    Parameters
    ----------
    method
        Sampling method, one of `DRAWS`.
    trials : array_like of int, shape (n,)
        Numbers of the trials, counted from 0.

    Examples
    --------
    >>> replicates("sobol", [0, 1, 16])
    array([0, 1, 0])
    >>> replicates("random", [0, 1, 16]) is None
    True
    """
    return None if method == "random" else np.asarray(trials, np.int64) % REPLICATES


def shape_generator(seed: int, trial: int, column: int) -> np.random.Generator:
    """Return the random generator for the figure of one column of one trial.

    Its stream is independent of every other stream of the seed.

    Parameters
    ----------
    seed
        Seed of the study.
    trial, column
        Number of the trial and index of the column among the perturbations, both counted from 0.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, 1 + column)))


def _random(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    """Return the first values of the stream of each trial."""
    result = np.empty((len(trials), columns))
    for row, trial in zip(result, trials.tolist(), strict=True):
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial,))).random(out=row)
    return np.maximum(result, SMALLEST, out=result)


def _from_blocks(
    draw: Callable[[int, int, int, int, int], Array],
    seed: int,
    trials: NDArray[np.int64],
    columns: int,
    size: int,
) -> Array:
    """Return rows of trials from blocks of `size` trials of one replicate; a block is drawn as a whole."""
    result = np.empty((len(trials), columns))
    position, replicate = np.divmod(trials, REPLICATES)
    block = position // size
    for r in np.unique(replicate).tolist():
        for b in np.unique(block[replicate == r]).tolist():
            selected = (replicate == r) & (block == b)
            result[selected] = draw(seed, r, b, columns, size)[position[selected] - b * size]
    return result


def _latin_hypercube(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    return _from_blocks(_hypercube, seed, trials, columns, -(-planned // REPLICATES))


@lru_cache(maxsize=REPLICATES)
def _hypercube(seed: int, replicate: int, block: int, columns: int, size: int) -> Array:
    """Draw a Latin hypercube, shape (size, columns) (McKay et al., Technometrics 21, 239, 1979)."""
    from scipy.stats.qmc import LatinHypercube

    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block, replicate, 0)))
    drawn = LatinHypercube(d=columns, rng=stream).random(size)
    np.clip(drawn, SMALLEST, LARGEST, out=drawn)
    drawn.flags.writeable = False
    return drawn


def _sobol(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    if columns > MOST_SOBOL_COLUMNS:
        raise InputError(
            f"draws = 'sobol': {columns} columns; allowed: up to {MOST_SOBOL_COLUMNS}, the largest dimension "
            "with known direction numbers; use draws = 'random' or 'latin_hypercube' instead"
        )
    most = max(SOBOL_BLOCK_VALUES // max(columns, 1), 1)
    size = 2 ** (min(-(-planned // REPLICATES), most).bit_length() - 1)
    return _from_blocks(_sobol_block, seed, trials, columns, size)


@lru_cache(maxsize=2 * REPLICATES)
def _sobol_block(seed: int, replicate: int, block: int, columns: int, size: int) -> Array:
    """Draw one block of a replicate's scrambled Sobol sequence (Owen, J. Complexity 14, 466, 1998)."""
    from scipy.stats.qmc import Sobol

    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, replicate, 1)))
    bits = 32
    engine = Sobol(columns, scramble=True, bits=bits, rng=stream)
    if block:
        engine.fast_forward(block * size)
    # Points are the lower ends of cells of the finest grid; the centres of the cells lie within (0, 1).
    drawn = engine.random(size) + 0.5 * 2.0**-bits
    drawn.flags.writeable = False
    return drawn


_METHODS: dict[str, Callable[[int, NDArray[np.int64], int, int], Array]] = {
    "random": _random,
    "latin_hypercube": _latin_hypercube,
    "sobol": _sobol,
}

DRAWS = tuple(_METHODS)
"""Names of the sampling methods, as a study file gives them."""
