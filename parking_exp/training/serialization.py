"""Nested state as JSON and arrays, so that nothing has to be pickled."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

ARRAY, SCALAR = "__array__", "__scalar__"  # keys of the dicts that stand for an array and for a NumPy scalar


def split(tree: Any, name: str = "") -> tuple[Any, dict[str, np.ndarray]]:
    """Split nested dicts and sequences into what JSON holds, and arrays by the path to them (`a/b/0`).

    NumPy scalars keep their type, since a mean of float32 is not a mean of float64. Sequences become lists.

    Raises:
        TypeError: something is of another kind.
    """
    if isinstance(tree, np.ndarray) and tree.dtype != object:
        return {ARRAY: name}, {name: tree}
    if isinstance(tree, np.generic):
        return {SCALAR: [tree.dtype.str, tree.item()]}, {}
    if tree is None or isinstance(tree, bool | int | float | str):
        return tree, {}
    arrays: dict[str, np.ndarray] = {}

    def part(key: object, value: Any) -> Any:
        plain, found = split(value, f"{name}/{key}" if name else str(key))
        arrays.update(found)
        return plain

    if isinstance(tree, Mapping):
        return {str(key): part(key, value) for key, value in tree.items()}, arrays
    if isinstance(tree, Iterable):
        return [part(number, value) for number, value in enumerate(tree)], arrays
    raise TypeError(f"{name} is a {type(tree).__name__}, which can't be saved without pickling it")


def join(plain: Any, arrays: Mapping[str, np.ndarray]) -> Any:
    """Put together what `split` took apart."""
    if isinstance(plain, list):
        return [join(value, arrays) for value in plain]
    if not isinstance(plain, dict):
        return plain
    if ARRAY in plain:
        return arrays[plain[ARRAY]]
    if SCALAR in plain:
        dtype, value = plain[SCALAR]
        return np.dtype(dtype).type(value)
    return {key: join(value, arrays) for key, value in plain.items()}
