"""Metrics of parking episodes: outcomes, strict parking, the pose at the end, the way there."""

import math

from parking_exp.tasks.metrics import (
    FAILURE_COLOUR,
    RETURN,
    STEPS,
    SUCCESS,
    TIMEOUT,
    Episode,
    Metric,
    outcome_rate,
    rate,
)

PATH_COLUMNS = ("x_m", "y_m", "heading_rad")
"""Columns of an episode's path."""
CRASH = outcome_rate("crash", FAILURE_COLOUR)


def _time_to_park(episode: Episode) -> float:
    """Return the duration of a successful episode [s], NaN of others."""
    return episode.info["time_s"] if episode.outcome == "success" else math.nan


def _path_efficiency(episode: Episode) -> float:
    """Return the length of the shortest path divided by the driven one; NaN without success."""
    driven_m = episode.info["path_m"]
    if episode.outcome != "success" or driven_m == 0:
        return math.nan
    return episode.info["shortest_path_m"] / driven_m


METRICS: tuple[Metric, ...] = (
    SUCCESS,
    CRASH,
    TIMEOUT,
    rate(
        "parked", lambda e: e.end.parked, colour="#000000",
        note="strict: inside the lines, within 10 degrees, stationary"
    ),
    STEPS,
    RETURN,
    Metric("distance_m", lambda e: e.end.distance_m, "Distance at the end", "m"),
    Metric(
        "heading_error_rad", lambda e: abs(e.end.heading_error_rad),
        "Heading error at the end", "rad"
    ),
    Metric("speed_mps", lambda e: abs(e.end.speed_mps), "Speed at the end", "m/s"),
    Metric("park_s", _time_to_park, "Time to success", "s", in_reports=True),
    Metric("path_m", lambda e: e.info["path_m"], "Driven path", "m", in_reports=True),
    Metric("path_efficiency", _path_efficiency, "Path efficiency", in_reports=True),
    Metric(
        "gear_changes", lambda e: e.info["gear_changes"], "Gear changes", "", "int64",
        in_reports=True
    ),
    # Wall-clock time of a planner, before the episode; other agents have none.
    Metric(
        "plan_s", lambda e: e.info.get("plan_s", math.nan), "Planning time", "s", in_reports=True
    ),
)  # fmt: skip
