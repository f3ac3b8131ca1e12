"""Importance of hyperparameters in a random or tuned search: variance explained by each alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

FEWEST_ROWS = 5


@dataclass(frozen=True)
class ParameterImportance:
    """What one parameter explains alone.

    Attributes:
        factor: its name.
        share: of the variance, in 0 ... 1.
        p: of a permutation test.
        direction: Spearman's rank correlation; None where it is no number or constant.
    """

    factor: str
    share: float
    p: float
    direction: float | None


def importance(
    frame: pd.DataFrame, parameters: Sequence[str], response: str, seed: int = 0, permutations: int = 999
) -> list[ParameterImportance]:
    """Return, for every parameter, the share of the response's variance that it explains alone, in the order given.

    `frame` has one row per configuration. Numbers: adjusted R^2 of a quadratic in the parameter's ranks, so that a
    log scale does not matter; booleans and words: the adjusted correlation ratio (Kelley 1935). Not below 0. p is
    that of a permutation of the response, (1 + as good) / (1 + permutations), not corrected for the number of
    parameters. The shares are marginal: they ignore interactions, need not add up, and after a tuner they show where
    it looked as well as what it found. A parameter, or a response, that never changes explains 0 with p 1.

    Raises:
        ValueError: fewer than 5 rows, or NaN in the response.
    """
    if len(frame) < FEWEST_ROWS or frame[response].isna().any():
        raise ValueError(f"importance needs at least {FEWEST_ROWS} runs, all with a response")
    y = frame[response].to_numpy(dtype=float)
    centred = y - y.mean()
    shuffled = np.random.default_rng(seed).permuted(np.tile(centred, (permutations, 1)), axis=1)
    return [_importance(frame[name], frame[response], centred, shuffled) for name in parameters]


def _importance(
    column: pd.Series, response: pd.Series, centred: np.ndarray, shuffled: np.ndarray
) -> ParameterImportance:
    name, total, n, direction = str(column.name), float(centred @ centred), len(centred), None
    if column.nunique(dropna=False) < 2 or total <= 1e-24 * n:
        return ParameterImportance(name, 0.0, 1.0, None)
    if column.dtype.kind in "iuf":
        ranks = column.rank()
        direction = float(ranks.corr(response.rank()))
        standard = ((ranks - ranks.mean()) / ranks.std()).to_numpy(dtype=float)
        design = np.stack([standard, standard**2], axis=1)
    else:
        codes = column.astype("category").cat.codes.to_numpy()
        design = (codes[:, None] == np.unique(codes)).astype(float)
    left, sizes, _ = np.linalg.svd(design - design.mean(axis=0), full_matrices=False)
    basis = left[:, sizes > 1e-9 * sizes.max()]  # orthonormal, of the centred columns
    explained = float(((centred @ basis) ** 2).sum()) / total
    by_chance = ((shuffled @ basis) ** 2).sum(axis=1) / total
    p = (1 + int(np.count_nonzero(by_chance >= explained - 1e-9))) / (1 + len(shuffled))
    degrees = n - 1 - basis.shape[1]
    share = 1 - (1 - explained) * (n - 1) / degrees if degrees > 0 else 0.0
    return ParameterImportance(name, min(max(share, 0.0), 1.0), p, direction)
