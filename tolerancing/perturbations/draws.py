"""Where probabilities come from: independent draws, Latin hypercubes, Sobol sequences.

Each trial has its own row of probabilities, one for each column of a study. A row depends on nothing but the
method, the seed, the trial's number, the number of columns and, for Latin hypercubes, the number of trials
planned; so it does not matter which worker draws it, in which run, or beside which other trials.

Designed draws are `REPLICATES` designs, randomised independently, that take turns: trial t is of replicate t
modulo `REPLICATES`. Their shares of good trials scatter as they do from study to study, which tells how sure
a yield is (Owen, Monte Carlo theory, methods and examples, 2013, section 17.5); a single design does not.

Streams of one seed are kept apart by their spawn keys: ``(trial,)`` draws a trial's values, ``(trial, 1 +
column)`` the random figure of one of its columns, and keys of three numbers make the designed draws.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError

SMALLEST, LARGEST = 2.0**-54, 1.0 - 2.0**-53
"""Ends of all probabilities; a normal distribution has no quantile of 0 or 1."""

MOST_SOBOL_COLUMNS = 21201
"""Dimensions of which direction numbers are known (Joe and Kuo, SIAM J. Sci. Comput. 30, 2635, 2008)."""

SOBOL_BITS = 32
SOBOL_BLOCK_VALUES = 2**16

REPLICATES = 16
"""Designs that take turns. More tell better how they scatter, fewer leave each design more trials; a power of
two leaves each Sobol sequence a whole net where the number of trials is one, too."""

MOST_TRIAL = 2**32 - 1
"""Largest number of a trial: a larger one takes two words of a spawn key, as a trial and a column do."""


def probabilities(method: str, seed: int, trials: Sequence[int], columns: int, planned: int) -> Array:
    """Probabilities of given trials.

    Parameters
    ----------
    method
        One of `DRAWS`.
    seed
        The study's seed.
    trials
        Numbers of the trials, from 0, in any order.
    columns
        Number of values of a trial.
    planned
        Number of trials of the study. A Latin hypercube has as many strata as a replicate has trials; trials
        beyond them fill further hypercubes of that size.

    Returns
    -------
    ndarray, shape (trials, columns)
        Each within (0, 1), without the ends.

    Raises
    ------
    InputError
        If there is no such method, a trial's number is negative or above `MOST_TRIAL`, or a Sobol sequence
        is asked for more than `MOST_SOBOL_COLUMNS` columns.
    """
    if method not in DRAWS:
        raise InputError(f"draws = {method!r}: there is no such way to draw; allowed: {', '.join(DRAWS)}")
    numbers = np.asarray(trials, dtype=np.int64).reshape(-1)
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() <= MOST_TRIAL:
        raise InputError(f"trials are numbered from 0 to {MOST_TRIAL}")
    return _METHODS[method](seed, numbers, columns, planned)


def replicates(method: str, trials: ArrayLike) -> NDArray[np.int64] | None:
    """Of which randomisation of the design trials are; None where each stands for itself.

    Parameters
    ----------
    method
        One of `DRAWS`.
    trials : array_like of int, shape (n,)
        Numbers of the trials, from 0.
    """
    return None if method == "random" else np.asarray(trials, np.int64) % REPLICATES


def shape_generator(seed: int, trial: int, column: int) -> np.random.Generator:
    """Generator of the random figure of one column of one trial; no other stream of the seed is like it.

    Parameters
    ----------
    seed
        The study's seed.
    trial, column
        Number of the trial, and index of the column among the perturbations, both from 0.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(trial, 1 + column)))


def _random(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    """First values of the stream of each trial."""
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
    """Rows of trials out of blocks of `size` trials of one replicate that are drawn as a whole."""
    result = np.empty((len(trials), columns))
    turn, replicate = np.divmod(trials, REPLICATES)
    block = turn // size
    for own in np.unique(replicate).tolist():
        for number in np.unique(block[replicate == own]).tolist():
            here = (replicate == own) & (block == number)
            result[here] = draw(seed, own, number, columns, size)[turn[here] - number * size]
    return result


def _latin_hypercube(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    return _from_blocks(_hypercube, seed, trials, columns, -(-planned // REPLICATES))


@lru_cache(maxsize=REPLICATES)
def _hypercube(seed: int, replicate: int, block: int, columns: int, size: int) -> Array:
    """Latin hypercube, shape (size, columns) (McKay, Beckman and Conover, Technometrics 21, 239, 1979)."""
    from scipy.stats.qmc import LatinHypercube

    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(block, replicate, 0)))
    drawn = LatinHypercube(d=columns, rng=stream).random(size)
    np.clip(drawn, SMALLEST, LARGEST, out=drawn)
    drawn.flags.writeable = False
    return drawn


def _sobol(seed: int, trials: NDArray[np.int64], columns: int, planned: int) -> Array:
    if columns > MOST_SOBOL_COLUMNS:
        raise InputError(
            f"draws = 'sobol': {columns} columns; allowed: up to {MOST_SOBOL_COLUMNS}, of which direction "
            "numbers are known; draw at random or from Latin hypercubes"
        )
    most = max(SOBOL_BLOCK_VALUES // max(columns, 1), 1)
    size = 2 ** (min(-(-planned // REPLICATES), most).bit_length() - 1)
    return _from_blocks(_sobol_block, seed, trials, columns, size)


@lru_cache(maxsize=2 * REPLICATES)
def _sobol_block(seed: int, replicate: int, block: int, columns: int, size: int) -> Array:
    """Points block * size, ... of a replicate's scrambled sequence (Owen, J. Complexity 14, 466, 1998)."""
    from scipy.stats.qmc import Sobol

    stream = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, replicate, 1)))
    engine = Sobol(columns, scramble=True, bits=SOBOL_BITS, rng=stream)
    if block:
        engine.fast_forward(block * size)
    # Points are the lower ends of cells of the finest grid; their middles lie within (0, 1).
    drawn = engine.random(size) + 0.5 * 2.0**-SOBOL_BITS
    drawn.flags.writeable = False
    return drawn


_METHODS: dict[str, Callable[[int, NDArray[np.int64], int, int], Array]] = {
    "random": _random,
    "latin_hypercube": _latin_hypercube,
    "sobol": _sobol,
}

DRAWS = tuple(_METHODS)
"""Ways to draw, by the name that a study file gives."""
