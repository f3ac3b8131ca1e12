"""Experiment files: from axes to cells, and from cells to runs.

`cells` of a config is a list of blocks; a block maps keys or groups to values, and stands for their product. A value
that is typed on the command line narrows the blocks that have its key, and a block without that value is left out; a
key that no block has is an axis of its own.
`seeds` is how many seeds, or which, each cell gets.
"""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from parking_exp.errors import ConfigError

Block = Mapping[str, Any]


def points(blocks: Sequence[Block], typed: Mapping[str, list[str]]) -> list[list[str]]:
    """Return the overrides of every cell.

    Args:
        blocks: of the experiment file; none: a single cell.
        typed: the values that stand on the command line for each key, in Hydra's syntax.

    Raises:
        ConfigError: no cell is left.
    """
    listed: dict[str, set[str]] = {}
    for block in blocks:
        for key, value in block.items():
            listed.setdefault(key, set()).update(_values(value))
    everywhere = {key: values for key, values in typed.items() if key not in listed}
    found: dict[tuple[str, ...], None] = {}
    for number, block in enumerate(blocks or [{}]):
        product = dict(everywhere)
        for key, value in block.items():
            own = _values(value)
            # What no block has, the first one takes.
            product[key] = [v for v in typed.get(key, own) if v in own or (number == 0 and v not in listed[key])]
        lines = [[f"{key}={value}" for value in values] for key, values in product.items()]
        found |= dict.fromkeys(itertools.product(*lines))
    if not found:
        raise ConfigError("no cell is left of the experiment")
    return [list(point) for point in found]


def seeds_of(value: object, default: int) -> list[int]:
    """Return the seeds that `seeds` means: n for 0 to n - 1, a list for these, None for the run's own.

    Raises:
        ConfigError: it is neither.
    """
    if value is None:
        return [default]
    if isinstance(value, int) and not isinstance(value, bool) and value > 0:
        return list(range(value))
    if isinstance(value, list) and value and all(isinstance(seed, int) for seed in value):
        return list(dict.fromkeys(value))
    raise ConfigError(f"seeds={value!r} is neither a number of seeds nor a list of them")


def _values(value: object) -> list[str]:
    return [written(item) for item in (value if isinstance(value, list) else [value])]


def written(value: object) -> str:
    """Write a YAML value as Hydra reads it on a command line."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, list):
        return f"[{','.join(written(item) for item in value)}]"
    return str(value)
