"""A page that plays recorded episodes: pick one, drag a slider, see lot, path, speed, steering."""

import json
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from parking_exp.pages.html_page import render_html, to_base64
from parking_exp.tasks.parking.episode_recording import MOTION, RecordedEpisode

TEMPLATE = Path(__file__).parent / "templates" / "replay.html.j2"
OUTCOME_ORDER = ("crash", "timeout", "success")
"""The order of episodes on the page."""

# Unit of each series [m, rad, m/s, m/s²], and how often differences are taken. A series is stored
# in whole numbers of its unit. Differences of smooth series are small numbers, which compress
# well. Controls may jump, so they are stored as they are.
FORMATS = {
    "x": (0.01, 2),
    "y": (0.01, 2),
    "heading": (0.001, 1),
    "speed": (0.02, 1),
    "acceleration": (0.1, 0),
    "steering": (0.01, 0),
    "rays": (0.1, 1),
}


def render_replay(episodes: Sequence[RecordedEpisode], steps_per_s: float, title: str) -> str:
    """Return a page, one HTML file, that plays episodes; failures come first."""
    in_order = sorted(episodes, key=lambda episode: OUTCOME_ORDER.index(episode.outcome))
    counts = Counter(episode.outcome for episode in in_order)
    recording = json.dumps(_recording(in_order, steps_per_s), separators=(",", ":"))
    return render_html(
        TEMPLATE,
        title=title,
        counts={name: counts[name] for name in OUTCOME_ORDER},
        recording=to_base64(zlib.compress(recording.encode(), 9)),
    )


def _recording(episodes: Sequence[RecordedEpisode], steps_per_s: float) -> dict[str, Any]:
    """Return what the page reads: the scenes of the episodes, and the series of each column."""
    scenes = []
    for episode in episodes:
        scene = {"seed": episode.seed, "outcome": episode.outcome}
        for name, shape in episode.shapes.items():
            scene[name] = np.round(shape, 3).tolist()
        scenes.append(scene)

    series = {}
    for column, name in enumerate(MOTION):
        series[name] = _series(name, [episode.motion[:, column] for episode in episodes])
    series["rays"] = _series("rays", [episode.rays.T for episode in episodes])
    return {"steps_per_s": steps_per_s, "scenes": scenes, "series": series}


def _series(name: str, values: Sequence[np.ndarray]) -> dict[str, Any]:
    """Return the values of all episodes as whole numbers of a unit, each of shape (..., time)."""
    unit, differences = FORMATS[name]
    episodes = []
    for episode in values:
        in_units = np.rint(episode / unit).astype(np.int64)
        before = np.zeros((*in_units.shape[:-1], differences), np.int64)
        episodes.append(np.diff(in_units, differences, prepend=before).tolist())
    return {"unit": unit, "differences": differences, "episodes": episodes}
