"""Key of a run: a hash of the config keys that change its results."""

import hashlib
import json
from collections.abc import Mapping
from typing import Any

WITHOUT_RESULT = frozenset(
    {"experiment_name", "output_dir", "tracking", "checkpoint", "timeout_s", "evaluation.video_episodes"}
)


def changes_results(key: str) -> bool:
    """Whether a dotted key can change a result."""
    parts = key.split(".")
    return WITHOUT_RESULT.isdisjoint(".".join(parts[:length]) for length in range(1, len(parts) + 1))


def result_part(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a config as plain containers, without the keys that change no result."""
    return {
        name: result_part(value, f"{prefix}{name}.") if isinstance(value, Mapping) else value
        for name, value in config.items()
        if changes_results(f"{prefix}{name}")
    }


def short_hash(value: Any) -> str:
    """Return a short hash of plain containers, whatever the order of their keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:10]
