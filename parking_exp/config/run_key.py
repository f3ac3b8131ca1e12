"""Which config keys change the results of a run, and the hash that makes the run key."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

NO_EFFECT = (
    "experiment_name",
    "output_dir",
    "tracking",
    "checkpoint",
    "timeout_s",
    "contrasts",
    "label",
    "init_latest",
    "evaluation.video_episodes",
)


def changes_results(key: str) -> bool:
    """Return whether a dotted key can change a result."""
    return not any(f"{key}.".startswith(f"{excluded}.") for excluded in NO_EFFECT)


def result_part(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested config without the keys that change no result."""
    part: dict[str, Any] = {}
    for name, value in config.items():
        key = f"{prefix}{name}"
        if not changes_results(key):
            continue
        if isinstance(value, Mapping):
            part[name] = result_part(value, f"{key}.")
        else:
            part[name] = value
    return part


def short_hash(value: Any) -> str:
    """Return a short hash of plain containers, whatever the order of their keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:10]
