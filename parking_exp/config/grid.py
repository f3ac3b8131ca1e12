"""Expand an experiment's cells from their axes, and cells into runs by seed.

`cells` of a config is a list of blocks; a block maps keys or groups to values, and stands for their product. `seeds` is
how many seeds, or which, each cell gets.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from parking_exp.errors import ConfigError

Block = Mapping[str, Any]
Point = list[str]
MOST_RUNS = 100_000


def points(
    blocks: Sequence[Block],
    typed: Mapping[str, list[str]],
    has: Callable[[str, Point], bool],
    experiment: str = "",
) -> list[Point]:
    """Return the overrides of every cell.

    Values that are typed narrow the blocks where they stand, and a block that is left with none is left out. A value
    that no block has takes the place of the values of every block where the key is an axis. A key that a block does
    not name goes to it as an axis of its own, if its configs have such a key.

    Args:
        blocks: of the experiment file; none: a single cell.
        typed: the values that stand on the command line for each key, in Hydra's syntax.
        has: whether the config that a point composes to has a key.
        experiment: its name, for the error.

    Raises:
        ConfigError: no cell is left.
    """
    listed: dict[str, set[str]] = {}
    axes = {key for block in blocks for key, value in block.items() if isinstance(value, list)}
    for block in blocks:
        for key, value in block.items():
            listed.setdefault(key, set()).update(_values(value))
    found: dict[tuple[str, ...], None] = {}
    for block in blocks or [{}]:
        product: dict[str, list[str]] = {}
        for key, value in block.items():
            own, asked = _values(value), typed.get(key, _values(value))
            takes_others = isinstance(value, list) or key not in axes
            product[key] = [v for v in asked if v in own or (takes_others and v not in listed[key])]
        lines = [[f"{key}={value}" for value in values] for key, values in product.items()]
        if not all(lines):
            continue
        first = [line[0] for line in lines]
        for key, values in typed.items():
            if key not in block and (key not in listed or has(key, first)):
                lines.append([f"{key}={value}" for value in values])
        check_number(len(found) + math.prod(map(len, lines)), "what is swept over")
        found |= dict.fromkeys(itertools.product(*lines))
    if not found:
        raise ConfigError(_no_cell(typed, listed, experiment))
    return [list(point) for point in found]


def _no_cell(typed: Mapping[str, list[str]], listed: Mapping[str, set[str]], experiment: str) -> str:
    """Say which of the typed values match no cell, and which values the cells have."""
    keys = {key: values for key, values in typed.items() if key in listed}
    asked = " ".join(f"{key}={','.join(values)}" for key, values in keys.items())
    there = " and ".join(f"{key}={','.join(sorted(listed[key]))}" for key in keys)
    return f"no cell of experiment {experiment} matches {asked}; its values are {there}"


def check_blocks(value: object) -> list[Block]:
    """Return `cells`, checked.

    Raises:
        ConfigError: it is not a list of mappings.
    """
    if value is None:
        return []
    if not isinstance(value, list) or not all(isinstance(block, dict) and block for block in value):
        raise ConfigError(f"cells={value!r} is not a list of {{key: [values]}}")
    return value


def seeds_of(value: object) -> list[int] | None:
    """Return the seeds that `seeds` means: n for 0 to n - 1, a list for these, None for the run's own.

    Raises:
        ConfigError: it is neither.
    """
    if value is None:
        return None
    if type(value) is int and value > 0:
        check_number(value, f"seeds={value}")
        return list(range(value))
    if isinstance(value, list) and value and all(type(seed) is int for seed in value):
        if beyond := [seed for seed in value if not 0 <= seed < 2**32]:
            raise ConfigError(f"seeds: {beyond[0]} is out of range; seeds are 0 to {2**32 - 1}")
        return list(dict.fromkeys(value))
    raise ConfigError(f"seeds={value!r} is neither a number of seeds (1 or more) nor a list of them, such as [0,1]")


def check_number(number: int, what: str) -> None:
    """Refuse more runs or cells than a sweep can have; `what` makes that many.

    Raises:
        ConfigError: they are too many.
    """
    if number > MOST_RUNS:
        raise ConfigError(f"{what} makes {number} runs; a sweep has {MOST_RUNS} at most")


def written(value: object) -> str:
    """Write a YAML value as Hydra reads it on a command line."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, list):
        return f"[{','.join(written(item) for item in value)}]"
    return str(value)


def _values(value: object) -> list[str]:
    return [written(item) for item in (value if isinstance(value, list) else [value])]
