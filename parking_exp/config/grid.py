"""Expand the cells of an experiment from its axes.

`cells` of a config is a list of blocks; a block maps keys or groups to values, and expands to their
product. `seeds` is the number or the list of seeds of each cell.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from parking_exp.config.overrides import in_quotes
from parking_exp.errors import ConfigError, suggestion

Block = Mapping[str, Any]
Point = tuple[str, ...]
"""The overrides of a cell."""
MAX_CELLS, MAX_SEEDS, MAX_RUNS = 10_000, 100_000, 100_000


def expand_points(
    blocks: Sequence[Block],
    axes: Mapping[str, list[str]],
    has: Callable[[str, Point], bool],
    experiment: str = "",
) -> list[Point]:
    """Return the overrides of every cell.

    Values on the command line select from the blocks that list them; blocks without any of them are
    dropped. A value that no block lists replaces the values of each block that sweeps over its key;
    a label that none lists is an error. Any other key becomes an axis of each block whose configs
    have it.

    Args:
        blocks: of the experiment file; none: a single cell.
        axes: the values of each key on the command line, in Hydra's syntax.
        has: whether the config of a point has a key.
        experiment: its name, for the error.

    Raises:
        ConfigError: there is no such label, no cell matches, or there are too many.
    """
    items = [item for block in blocks for item in block.items()]
    listed = {
        key: {value for k, values in items if k == key for value in _values(values)}
        for key, _ in items
    }
    swept = {key for key, values in items if isinstance(values, list)}
    if blocks and (
        unknown := [
            label for label in axes.get("label", ()) if label not in listed.get("label", ())
        ]
    ):
        hint = suggestion(unknown[0], listed.get("label", ())) or "; select cells by their keys"
        raise ConfigError(f"label={unknown[0]}: experiment={experiment} has no such label{hint}")
    cells: dict[Point, None] = {}
    for block in blocks or [{}]:
        lines = []
        for key, value in block.items():
            values, replaceable = _values(value), isinstance(value, list) or key not in swept
            kept = [
                v
                for v in axes.get(key, values)
                if v in values or (replaceable and v not in listed[key])
            ]
            lines.append([_override(key, v) for v in kept])
        if not all(lines):
            continue
        first = tuple(values[0] for values in lines)
        for key, values in axes.items():
            if key not in block and (key not in listed or has(key, first)):
                lines.append([_override(key, v) for v in values])
        if len(cells) + math.prod(map(len, lines)) > MAX_CELLS:
            raise ConfigError(f"a sweep has at most {MAX_CELLS} cells")
        cells |= dict.fromkeys(itertools.product(*lines))
    if not cells:
        narrowed = " ".join(f"{key}={','.join(axes[key])}" for key in axes if key in listed)
        raise ConfigError(f"{narrowed}: experiment={experiment} has no such cell")
    return list(cells)


def check_blocks(value: Any) -> list[Block]:
    """Return `cells` if it is a list of mappings."""
    if not isinstance(value or [], list) or not all(
        isinstance(block, dict) and block for block in value or []
    ):
        raise ConfigError(f"cells={value!r} is not a list of {{key: [values]}}")
    for block in value or []:
        labels = block.get("label")
        for label in labels if isinstance(labels, list) else [labels]:
            if not isinstance(label, str | None):  # how it was written is lost: 0.10 is 0.1
                raise ConfigError(
                    f"cells: the label {label!r} is no text; put it in quotes, label: '...'"
                )
    return value or []


def seeds_of(value: object) -> list[int] | None:
    """Return the seeds that `seeds` defines: 0 to n - 1 for n, the seeds of a list, None for the
    run's own seed.
    """
    if type(value) is int and 0 < value <= MAX_SEEDS:
        return list(range(value))
    if (
        isinstance(value, list)
        and value
        and all(type(seed) is int and 0 <= seed < 2**32 for seed in value)
    ):
        return list(dict.fromkeys(value))
    if value is not None:
        raise ConfigError(
            f"seeds={value!r} is neither a number up to {MAX_SEEDS} nor a list of seeds below "
            f"{2**32}"
        )
    return None


def _override(key: str, value: str) -> str:
    is_text = key.lstrip("+") == "label" and value != "null"  # others: in Hydra's syntax
    return f"{key}={in_quotes(value) if is_text else value}"


def _values(value: object) -> list[str]:
    return [yaml_text(item) for item in (value if isinstance(value, list) else [value])]


def yaml_text(value: object) -> str:
    """Write a scalar or a list as YAML and Hydra's command line read it."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    return f"[{','.join(map(yaml_text, value))}]" if isinstance(value, list) else str(value)
