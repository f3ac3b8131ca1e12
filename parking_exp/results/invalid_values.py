"""Values of a database that are not of their column's type: they count as missing, and are said.

SQLite keeps whatever is written into a column, so that a time may be a word and a number nothing at all.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from reprlib import repr as shortened
from typing import Any

from parking_exp.tracking.reader import Point, StoredRun

Found = dict[str, list[str]]
"""What is impossible, as `name=value`, by run id."""


def sound_runs(runs: Iterable[StoredRun]) -> tuple[list[StoredRun], Found]:
    """Return runs without impossible values, and these."""
    sound: list[StoredRun] = []
    found: Found = {}
    for run in runs:
        bad: list[str] = []
        kept = replace(
            run,
            name=_kept("name", run.name, str, "", bad),
            start_ms=_kept("start_time", run.start_ms, int | None, None, bad),
            end_ms=_kept("end_time", run.end_ms, int | None, None, bad),
            artifact_uri=_kept("artifact_uri", run.artifact_uri, str, "", bad),
            tags=_entries(run.tags, str, bad),
            params=_entries(run.params, str, bad),
            metrics=_entries(run.metrics, float | int, bad),
        )
        sound.append(kept)
        if bad:
            found[run.run_id] = bad
    return sound, found


def sound_points(histories: Mapping[str, Sequence[Point]]) -> tuple[dict[str, list[Point]], Found]:
    """Return histories without impossible points, and these."""
    sound: dict[str, list[Point]] = {}
    found: Found = {}
    for key, points in histories.items():
        sound[key] = [point for point in points if _is_sound(point)]
        bad = [point for point in points if not _is_sound(point)] if len(sound[key]) < len(points) else []
        for run_id, step, time_ms, value in bad:
            where = f"step={shortened(step)}, time={shortened(time_ms)}"
            found.setdefault(run_id, []).append(f"{key}={shortened(value)} ({where})")
    return sound, found


def _is_sound(point: Point) -> bool:
    _, step, time_ms, value = point
    return isinstance(step, int) and isinstance(time_ms, int) and isinstance(value, float | int)


def _entries(values: Mapping[str, Any], kind: Any, bad: list[str]) -> dict[str, Any]:
    bad += [f"{key}={shortened(value)}" for key, value in values.items() if not isinstance(value, kind)]
    return {key: value for key, value in values.items() if isinstance(value, kind)}


def _kept(name: str, value: Any, kind: Any, missing: Any, bad: list[str]) -> Any:
    if isinstance(value, kind):
        return value
    bad.append(f"{name}={shortened(value)}")
    return missing
