"""Metrics as users write them."""

from parking_exp.tasks.metrics import Metric

centred = Metric(
    "centred", of=lambda episode: episode.end.distance_m < 0.5, label="Centred", dtype="bool"
)
last_speed = Metric(
    "last_speed",
    of=lambda episode: episode.info["speed"],
    label="Last speed",
    unit="m/s",
)
was_lost = Metric("was_lost", of=lambda episode: episode.info["lost"], label="Lost", dtype="bool")
second_success = Metric("success", of=lambda episode: True, label="Success", dtype="bool")
ended = Metric(
    "ended",
    of=lambda episode: episode.info["crashed"] or episode.info["is_success"],
    label="Ended",
    dtype="bool",
)
position = Metric("position", of=lambda episode: episode.end["at"][0], label="Position")
spaced = Metric("two words", of=lambda episode: 1.0, label="Two words")
