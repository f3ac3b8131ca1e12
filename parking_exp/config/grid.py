"""Expand the cells of an experiment from its axes.

`cells` of a config is a list of blocks; a block maps keys or groups to values, and expands to their
product. `seeds` is the number or the list of seeds of each cell.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from parking_exp.config.overrides import in_quotes
from parking_exp.config.settings import yaml_text
from parking_exp.errors import ConfigError
from parking_exp.phrases import suggestion

Block = Mapping[str, Any]
Point = tuple[str, ...]
"""The overrides of a cell."""
MAX_CELLS = 10_000
MAX_SEEDS = 100_000
MAX_RUNS = 100_000


def expand_points(
    blocks: Sequence[Block],
    axes: Mapping[str, list[str]],
    has: Callable[[str, Point], bool],
    experiment: str = "",
) -> list[Point]:
    """Return the overrides of every cell.

    Values on the command line select from the blocks that list them, and drop blocks without any
    of them. A value that no block lists replaces the values of each block that sweeps over its key.
    A label that no block lists is an error. Any other key becomes an axis of each block whose
    configs have it.

    Args:
        blocks: the experiment file's `cells`. Without blocks, there is a single cell.
        axes: the values of each key on the command line, in Hydra's syntax.
        has: whether the config of a point has a key.
        experiment: its name, for the error.

    Raises:
        ConfigError: there is no such label, no cell matches, or there are too many.
    """
    listed = _listed_values(blocks)
    if blocks:
        _check_labels(axes.get("label", []), listed.get("label", set()), experiment)
    points: dict[Point, None] = {}
    for block in blocks or [{}]:
        choices = []
        for key, value in block.items():
            values = _values(value)
            if key in axes:
                selectable = set(values)
                if isinstance(value, list) or not _is_swept(key, blocks):
                    selectable |= set(axes[key]) - listed[key]
                values = [item for item in axes[key] if item in selectable]
            choices.append([_override(key, item) for item in values])
        if not all(choices):
            continue

        first = tuple(overrides[0] for overrides in choices)
        for key, values in axes.items():
            if key not in block and (key not in listed or has(key, first)):
                choices.append([_override(key, item) for item in values])
        if len(points) + math.prod(map(len, choices)) > MAX_CELLS:
            raise ConfigError(f"a sweep has at most {MAX_CELLS} cells")
        points |= dict.fromkeys(itertools.product(*choices))
    if not points:
        narrowed = " ".join(f"{key}={','.join(axes[key])}" for key in axes if key in listed)
        raise ConfigError(f"{narrowed}: experiment={experiment} has no such cell")
    return list(points)


def _is_swept(key: str, blocks: Sequence[Block]) -> bool:
    """Return whether any block gives a key a list of values."""
    return any(isinstance(block.get(key), list) for block in blocks)


def _listed_values(blocks: Sequence[Block]) -> dict[str, set[str]]:
    """Return the values that blocks list for each key."""
    listed: dict[str, set[str]] = {}
    for block in blocks:
        for key, value in block.items():
            listed.setdefault(key, set()).update(_values(value))
    return listed


def _check_labels(given: Sequence[str], listed: set[str], experiment: str) -> None:
    """Refuse a label that no block lists."""
    for label in given:
        if label not in listed:
            hint = suggestion(label, listed) or "; select cells by their keys"
            raise ConfigError(f"label={label}: experiment={experiment} has no such label{hint}")


def read_blocks(value: Any) -> list[Block]:
    """Return `cells` if it is a list of mappings."""
    blocks = value or []
    if not isinstance(blocks, list) or not all(block and type(block) is dict for block in blocks):
        raise ConfigError(f"cells={value!r} is not a list of {{key: [values]}}")
    for block in blocks:
        labels = block.get("label")
        if not isinstance(labels, list):
            labels = [labels]
        for label in labels:
            if not isinstance(label, str | None):  # how it was written is lost: 0.10 is 0.1
                raise ConfigError(
                    f"cells: the label {label!r} is not text; put it in quotes, label: '...'"
                )
    return blocks


def seeds_of(value: object) -> list[int] | None:
    """Return the seeds that `seeds` defines.

    A number n stands for 0 to n - 1, and None for the run's own seed.
    """
    if value is None:
        return None
    if type(value) is int and 0 < value <= MAX_SEEDS:
        return list(range(value))
    if isinstance(value, list) and value and all(map(_is_seed, value)):
        return list(dict.fromkeys(value))
    raise ConfigError(
        f"seeds={value!r} is neither a number up to {MAX_SEEDS} nor a list of seeds below {2**32}"
    )


def _is_seed(value: object) -> bool:
    return type(value) is int and 0 <= value < 2**32


def _override(key: str, value: str) -> str:
    """Return an override in Hydra's syntax; only values of `label` still need quotes."""
    if key.lstrip("+") == "label" and value != "null":
        value = in_quotes(value)
    return f"{key}={value}"


def _values(value: object) -> list[str]:
    """Return the values that a block gives a key, in Hydra's syntax."""
    items = value if isinstance(value, list) else [value]
    return [yaml_text(item) for item in items]
