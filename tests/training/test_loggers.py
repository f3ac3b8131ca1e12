"""The logs of a run besides metrics.jsonl are made from it."""

import json

from support.runs import names_in
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from parking_exp.config.compose import compose
from parking_exp.runs.metric_logs import MetricsLog
from parking_exp.training.loggers import make_logger


def ignore(step, row):
    """No tracker."""


def written(folder):
    """TensorBoard's points by tag, each as often as it was written."""
    board = EventAccumulator(str(folder), size_guidance={"scalars": 0}, purge_orphaned_data=False)
    board.Reload()
    return {
        tag: [(event.step, event.value) for event in board.Scalars(tag)]
        for tag in board.Tags()["scalars"]
    }


def test_a_resumed_run_has_each_step_once_in_tensorboard_under_its_label(tmp_path):
    tracking = compose("experiment=smoke").tracking
    log = tmp_path / "metrics.jsonl"
    killed = make_logger(tracking, tmp_path, MetricsLog(log), "n=8", ignore)
    for step in (1, 2, 3):
        killed.record("eval/success_rate", 0.5)
        killed.record("buffer/real_share", 0.25)
        killed.record("certified/success_rate", 1.0)
        killed.dump(step)
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[:2]))  # as of the last checkpoint
    resumed = make_logger(tracking, tmp_path, MetricsLog(log), "her /no noise", ignore)
    resumed.record("eval/success_rate", 0.75)
    resumed.dump(3)
    resumed.close()
    assert names_in(tmp_path / "tensorboard") == ["her _no noise"]
    assert written(tmp_path / "tensorboard" / "her _no noise") == {
        "eval/success_rate": [(1, 0.5), (2, 0.5), (3, 0.75)],
        "replay/real_share": [(1, 0.25), (2, 0.25)],
        "final/certified_success_rate": [(1, 1.0), (2, 1.0)],
    }
    assert "buffer/real_share" in json.loads(lines[0])["metrics"]
