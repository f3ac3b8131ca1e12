"""Key of a run: a hash of the config keys that change its results."""

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
    "evaluation.video_episodes",
)


def changes_results(key: str) -> bool:
    """Return whether a dotted key can change a result."""
    return not any(f"{key}.".startswith(f"{excluded}.") for excluded in NO_EFFECT)


def result_part(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a nested config without the keys that change no result."""
    return {
        name: result_part(value, f"{prefix}{name}.") if isinstance(value, Mapping) else value
        for name, value in config.items()
        if changes_results(f"{prefix}{name}")
    }


def trained_part(config: Mapping[str, Any], evaluation: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys that can change the training or its learning curve: what run keys hash.

    Args:
        config: keys that differ from their defaults; a new key keeps the hashes of older runs.
        evaluation: all keys of `evaluation` that the training itself uses.
    """
    part = result_part(config)
    part["evaluation"] = evaluation
    return part


def short_hash(value: Any) -> str:
    """Return a short hash of plain containers, whatever the order of their keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:10]
