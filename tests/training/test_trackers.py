"""Trackers of a user's own package, named in the config."""

import errno
import json

import pytest
from support.runs import config_refusal, run_script

from parking_exp.config.allowlist import check_trust
from parking_exp.config.compose import compose
from parking_exp.errors import FailedRunError, InterruptedRunError, UntrustedError
from parking_exp.runs.directory import RunDirectory
from parking_exp.sweeps.single_run import train
from parking_exp.training import training_session

WRITES = "support.user_trackers.WritesJson"
SHORT = (
    "experiment=smoke",
    "total_timesteps=200",
    "tracking.mlflow=false",
    "evaluation.video_episodes=0",
)


def config(tmp_path, tracker, *overrides):
    return compose(*SHORT, f"output_dir={tmp_path}", f"tracking.trackers=[{tracker}]", *overrides)


def calls(run_dir):
    """The calls of a run's tracker."""
    return [json.loads(line) for line in (run_dir.parent / "calls.jsonl").read_text().splitlines()]


def logged(run_dir):
    """The calls that a run's metrics.jsonl stands for."""
    rows = [json.loads(line) for line in (run_dir / "metrics.jsonl").read_text().splitlines()]
    return [["log", row["step"], row["metrics"]] for row in rows]


def test_a_tracker_gets_the_config_each_row_of_metrics_and_the_end(tmp_path):
    run = config(tmp_path, WRITES, "seed=3")

    train(run)

    rows = logged(run.run_dir)
    assert len(rows) > 2
    assert rows[-1][2].keys() >= {"final/success_rate"}
    assert calls(run.run_dir) == [["start", 3], *rows, ["finish", "done"]]


def test_a_resumed_run_logs_what_comes_after_its_checkpoint(tmp_path, monkeypatch):
    run = config(tmp_path, WRITES, "evaluation.every_n_steps=50", "checkpoint.every_n_steps=50")
    stop_if_asked = training_session.TrainingSession.stop_if_asked

    def stop(self):
        if self.model.num_timesteps >= 100:
            raise InterruptedRunError("at step 100", 2)
        stop_if_asked(self)

    with monkeypatch.context() as patch, pytest.raises(InterruptedRunError):
        patch.setattr(training_session.TrainingSession, "stop_if_asked", stop)
        train(run)
    assert calls(run.run_dir)[-1] == ["finish", "interrupted"]
    train(run)

    rows = logged(run.run_dir)
    assert [call for call in calls(run.run_dir) if call[0] == "log"] == rows
    ends = [call for call in calls(run.run_dir) if call[0] != "log"]
    assert ends == [["start", 0], ["finish", "interrupted"], ["start", 0], ["finish", "done"]]


@pytest.mark.parametrize("disk_is_full", [False, True])
def test_a_tracker_learns_that_its_run_has_failed(tmp_path, monkeypatch, disk_is_full):
    run = config(tmp_path, WRITES)
    update_status = RunDirectory.update_status

    def fail(self):
        raise RuntimeError("a loss of NaN")

    def update_if_there_is_room(self, **entries):
        if disk_is_full and entries.get("status") == "failed":
            raise OSError(errno.ENOSPC, "No space left on device")
        update_status(self, **entries)

    monkeypatch.setattr(training_session.TrainingSession, "learn", fail)
    monkeypatch.setattr(RunDirectory, "update_status", update_if_there_is_room)
    with pytest.raises(FailedRunError, match="a loss of NaN"):
        train(run)

    assert calls(run.run_dir) == [["start", 0], ["finish", "failed"]]


@pytest.mark.parametrize("call", ["start", "log", "finish"])
def test_a_tracker_that_raises_is_reported_once_and_stops_no_run(tmp_path, capsys, call):
    run = config(tmp_path, f"{{_target_:{WRITES},fails_in:{call}}}")

    result = train(run)

    assert result.steps == 200
    sentence = (
        f"the tracker {WRITES} failed (ConnectionError: no network); the run goes on without it"
    )
    assert capsys.readouterr().err.count(sentence) == 1
    assert [kind for kind, *_ in calls(run.run_dir)].count(call) == 1
    assert calls(run.run_dir)[-1][0] == call


def test_a_tracker_without_log_is_reported_when_the_run_starts(tmp_path, capsys):
    train(config(tmp_path, "support.user_trackers.LacksLog"))

    error = capsys.readouterr().err
    assert "the tracker support.user_trackers.LacksLog failed (TypeError: " in error
    assert "abstract method log" in error


def test_trackers_work_in_the_processes_of_a_sweep(tmp_path):
    run_script(
        "train",
        *SHORT,
        "seeds=2",
        f"output_dir={tmp_path}",
        f"tracking.trackers=[{WRITES}]",
        env={"PYTHONPATH": "tests"},
        code=0,
    )

    (run_dir, other) = sorted(tmp_path.glob("smoke/*/seed=*"))
    ends = sorted(call for call in calls(run_dir) if call[0] != "log")
    assert ends == [["finish", "done"], ["finish", "done"], ["start", 0], ["start", 1]]
    n_rows = len(logged(run_dir)) + len(logged(other))
    assert [call[0] for call in calls(run_dir)].count("log") == n_rows


def test_trackers_change_no_key_of_a_run_and_are_not_trusted_in_the_runs_of_others(tmp_path):
    plain = compose(*SHORT, f"output_dir={tmp_path}")
    tracked = config(tmp_path, WRITES)

    assert tracked.run_key == plain.run_key
    with pytest.raises(UntrustedError, match=rf"^tracking\.trackers\.0\._target_={WRITES}"):
        check_trust(tracked, tmp_path)


@pytest.mark.parametrize(
    ("tracker", "problem"),
    [
        ("a.B", "tracking.trackers.0._target_=a.B: ModuleNotFoundError: No module named 'a'"),
        (
            "parking_exp.algorithms.SAC",
            "tracking.trackers.0._target_=parking_exp.algorithms.SAC is not a subclass of "
            "parking_exp.training.trackers.Tracker",
        ),
        (
            f"{{_target_:{WRITES},fails_inn:log}}",
            "tracking.trackers.0.fails_inn: there is no such key; did you mean 'fails_in'?",
        ),
        (
            f"{{_target_:{WRITES},run_dir:here}}",
            "tracking.trackers.0.run_dir is set by the run itself",
        ),
    ],
)
def test_what_is_no_tracker_is_refused(tracker, problem):
    assert config_refusal(f"tracking.trackers=[{tracker}]") == problem
