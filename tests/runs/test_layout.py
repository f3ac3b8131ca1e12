"""Run directories of other versions of this package: recognised, named, and left as they are."""

import json

import pytest
from support.runs import make_config, type_here

from parking_exp.config.compose import composed, composed_runs
from parking_exp.config.overrides import in_quotes
from parking_exp.config.paths import default_uri
from parking_exp.errors import ConfigError, OutputDirectoryError
from parking_exp.evaluation.evaluate_run import evaluate_run
from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.runs.files import read_json
from parking_exp.runs.layout_version import LAYOUT, refusal
from parking_exp.runs.state import read_state
from parking_exp.sweeps.plan import plan
from parking_exp.tracking.sync_all import sync_all, sync_problem
from parking_exp.training.run import train

COMMIT = "01fb74c84089c3686088e6eed2fc86f4a6c57eda"
# Of Stable-Baselines3 alone: a class of ours that has moved would give the run another key, and so another directory.
SAME_KEY = ("experiment=smoke", "algorithm=tqc")


def made_by_another_version(output_dir, status, layout=None):
    """A run directory with a new one's files but for the layout; None: of a version that had no number for it."""
    config = make_config(*SAME_KEY, f"output_dir={output_dir}")
    directory = RunDirectory(config.run_dir)
    directory.create(config)
    directory.update(tracking_uri=default_uri(output_dir))
    if status == "done":
        directory.finish(RunResult(str(directory.path), None, 400, {"final/success_rate": 0.5}), success_rate=0.5)
    else:
        directory.update(status=status, total_timesteps=400)
        (directory.checkpoints / "step=0000000100").mkdir(parents=True)
    directory.models.mkdir()
    for name in ("final.zip", "best.zip"):
        (directory.models / name).write_bytes(b"a model")
    (directory.path / "provenance.json").write_text(json.dumps({"started_ms": 1, "tags": {"git_commit": COMMIT}}))
    entries = read_json(directory.path / "status.json")
    del entries["layout"]
    (directory.path / "status.json").write_text(json.dumps({**({"layout": layout} if layout else {}), **entries}))
    return directory


def contents(output_dir):
    return {path: path.is_file() and (path.read_bytes(), path.stat().st_mtime_ns) for path in output_dir.rglob("*")}


def test_a_run_of_an_earlier_version_says_which_commit_can_use_it(tmp_path):
    directory = made_by_another_version(tmp_path, "done")
    assert directory.version_problem == (
        "it was made by an earlier version of parking_exp and is left as it is: `git checkout 01fb74c84089` gives the "
        "version that can use it; to train it anew with this one, move it away first"
    )
    (directory.path / "provenance.json").unlink()
    assert "is left as it is: that version can use it; " in directory.version_problem


@pytest.mark.parametrize(("layout", "maker"), [(None, "an earlier"), (LAYOUT + 1, "a later")])
def test_a_state_names_the_version_that_made_the_run(tmp_path, layout, maker):
    directory = made_by_another_version(tmp_path, "done", layout)
    assert read_state(directory.path).other_version == f"{maker} version of parking_exp"


def test_new_and_damaged_runs_are_of_this_version(tmp_path):
    directory = RunDirectory(tmp_path / "mine" / "cell" / "seed=0")
    assert directory.version_problem is None
    directory.path.mkdir(parents=True)
    directory.update(status="running")
    assert read_json(directory.path / "status.json") == {"layout": LAYOUT, "status": "running"}
    assert directory.version_problem is None
    (directory.path / "status.json").write_text("")  # as a power cut leaves it
    assert directory.version_problem is None


def test_evaluating_a_run_of_another_version_is_refused_and_changes_nothing(tmp_path):
    directory = made_by_another_version(tmp_path, "done")
    before = contents(tmp_path)
    (config,) = composed("evaluate", [f"run={in_quotes(str(directory.path))}", f"output_dir={tmp_path}"])
    with pytest.raises(ConfigError, match="seed=0: it was made by an earlier version"):
        evaluate_run(config)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("status", ["running", "interrupted", "failed", "pending"])
def test_a_run_that_another_version_has_begun_is_not_gone_on_with(tmp_path, status):
    made_by_another_version(tmp_path, status)
    before = contents(tmp_path)
    with pytest.raises(OutputDirectoryError, match="seed=0: it was made by an earlier version"):
        train(make_config(*SAME_KEY, f"output_dir={tmp_path}"))
    with pytest.raises(OutputDirectoryError, match="seed=0: it was made by an earlier version"):
        plan(composed_runs("config", [*SAME_KEY, f"output_dir={tmp_path}"]), retry="failed")
    assert contents(tmp_path) == before


def test_the_result_of_another_version_stays(tmp_path, capsys):
    made_by_another_version(tmp_path, "done")
    before = contents(tmp_path)
    (run,) = plan(composed_runs("config", [*SAME_KEY, f"output_dir={tmp_path}"]))
    assert not run.is_due
    assert contents(tmp_path) == before
    assert train(run.config).metrics == {"final/success_rate": 0.5}
    assert "already done" in capsys.readouterr().out


def test_a_class_that_has_moved_gives_a_run_another_directory(tmp_path):
    ours = make_config("experiment=smoke", f"output_dir={tmp_path}")
    assert ours.algorithm.target == "parking_exp.algorithms.SAC"
    earlier = ours.model_copy(
        update={"algorithm": ours.algorithm.model_copy(update={"target": "parking_exp.lean.SAC"})}
    )
    assert earlier.run_dir != ours.run_dir


def test_a_run_of_another_version_is_not_synced_and_not_changed(tmp_path):
    directory = made_by_another_version(tmp_path, "interrupted")
    before = contents(directory.path)
    ((found, problem),) = sync_all([directory], [default_uri(tmp_path)])
    assert (found, problem) == (directory, directory.version_problem)
    assert sync_problem([directory], [default_uri(tmp_path)]) is None
    assert contents(directory.path) == before


def test_what_a_store_lacks_is_one_sentence_with_what_to_type(tmp_path):
    other = made_by_another_version(tmp_path, "interrupted")
    directories = [RunDirectory(tmp_path / "mine" / "cell" / f"seed={seed}") for seed in range(2)]
    for directory in directories:
        directory.path.mkdir(parents=True)
        directory.update(status="done", tracking_uri="http://elsewhere:5000")
    uri = "http://elsewhere:5000"
    assert sync_problem([other, *directories], [default_uri(tmp_path)]) == (
        f"the store has not got all of 2 runs (it is tracked in {uri}, which was not named; tracking.uri={uri} sends it "
        f"there); `python scripts/status.py sync=true output_dir={tmp_path} tracking.uri={uri}` sends what is missing"
    )


def test_status_lists_runs_of_another_version_with_a_line_of_their_own(tmp_path):
    made_by_another_version(tmp_path, "interrupted")
    before = contents(tmp_path)
    done = type_here("status", f"output_dir={tmp_path}")
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()[2:]] == ["version"]
    assert "1 run made by an earlier version of parking_exp: " in done.stdout
    assert contents(tmp_path) == before


def test_a_commit_that_is_none_is_not_to_be_typed(tmp_path):
    (tmp_path / "provenance.json").write_text(json.dumps({"tags": {"git_commit": "x;rm -rf ~   "}}))
    assert "git checkout" not in refusal(tmp_path, "an earlier version of parking_exp")
