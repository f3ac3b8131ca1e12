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
from parking_exp.tasks.parking.scene_shapes import Rectangle, SceneShapes

TEMPLATE = Path(__file__).parent / "templates" / "replay.html.j2"
OUTCOMES = ("crash", "timeout", "success")
"""In the order of the page."""

# The smallest difference that the page shows, in m, rad, m/s and m/s².
UNITS = {
    "x": 0.01,
    "y": 0.01,
    "heading": 0.001,
    "speed": 0.02,
    "acceleration": 0.1,
    "steering": 0.01,
}
RAY_UNIT_M = 0.1
# A series of n numbers is stored as its differences, or the differences of those: what is smooth
# becomes small numbers, which compress well. Controls may jump, and are stored as they are.
DIFFERENCES = {"x": 2, "y": 2, "heading": 1, "speed": 1, "acceleration": 0, "steering": 0}


def render_replay(episodes: Sequence[RecordedEpisode], steps_per_s: float, title: str) -> str:
    """Return a page, one HTML file, that plays episodes; failures come first."""
    in_order = sorted(episodes, key=lambda episode: OUTCOMES.index(episode.outcome))
    counts = Counter(episode.outcome for episode in in_order)
    recording = json.dumps(_recording(in_order, steps_per_s), separators=(",", ":"))
    return render_html(
        TEMPLATE,
        title=title,
        counts={name: counts[name] for name in OUTCOMES},
        recording=to_base64(zlib.compress(recording.encode(), 9)),
    )


def _recording(episodes: Sequence[RecordedEpisode], steps_per_s: float) -> dict[str, Any]:
    """Return what the page reads: the scenes of the episodes, and the series of each column."""
    scenes = []
    for episode in episodes:
        shapes = _plain_shapes(episode.shapes)
        scenes.append({"seed": episode.seed, "outcome": episode.outcome, **shapes})

    series = {}
    for column, name in enumerate(MOTION):
        values = [episode.motion[:, column] for episode in episodes]
        series[name] = _series(values, UNITS[name], DIFFERENCES[name])
    rays = []
    for episode in episodes:
        distances = np.empty((0, 0)) if episode.rays is None else episode.rays
        rays.append(distances.T)
    series["rays"] = _series(rays, RAY_UNIT_M, 1)
    return {"steps_per_s": steps_per_s, "scenes": scenes, "series": series}


def _plain_shapes(shapes: SceneShapes) -> dict[str, Any]:
    plain: dict[str, Any] = {}
    for name, shape in vars(shapes).items():
        if isinstance(shape, Rectangle):
            plain[name] = _rounded(shape)
        else:
            plain[name] = [_rounded(rectangle) for rectangle in shape]
    return plain


def _rounded(rectangle: Rectangle) -> list[float]:
    return [round(value, 3) for value in rectangle]


def _series(values: Sequence[np.ndarray], unit: float, differences: int) -> dict[str, Any]:
    """Return the values of all episodes as whole numbers of `unit`, each of shape (..., time)."""
    episodes = []
    for episode in values:
        whole = np.rint(episode / unit).astype(np.int64)
        before = np.zeros((*whole.shape[:-1], differences), np.int64)
        episodes.append(np.diff(whole, differences, prepend=before).tolist())
    return {"unit": unit, "differences": differences, "episodes": episodes}
