"""Metrics of parking episodes: outcomes, strict parking, and the pose of the car at the end."""

from parking_exp.tasks.metrics import (
    FAILURE_COLOUR,
    RETURN,
    STEPS,
    SUCCESS,
    TIMEOUT,
    Metric,
    outcome_rate,
    rate,
)

METRICS: tuple[Metric, ...] = (
    SUCCESS,
    outcome_rate("crash", FAILURE_COLOUR),
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
)  # fmt: skip
