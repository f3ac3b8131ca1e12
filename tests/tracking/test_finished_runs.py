"""A finished run in the store stays whole: damaged files do not replace it, lost artifacts are sent
again.
"""

import json
import shutil

import pytest
from support.runs import artifacts, call_script, store, sync_stored
from support.sync_processes import sync
from support.tracked_runs import files_below, finished_run, rows, written_run

from parking_exp.errors import StoreError
from parking_exp.results.frames import load
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.file_hashes import changed_files, write_summary
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import complete_store


def stored_files(directory):
    """Every artifact of the run, by name."""
    runs = directory.output_dir / "mlflow-artifacts" / "smoke"
    return files_below(runs / directory.run_id / "artifacts")


@pytest.fixture
def finished(output_dir):
    """A finished run that the store has."""
    directory = finished_run(output_dir)
    directory.models.mkdir(exist_ok=True)
    (directory.models / "final.zip").write_bytes(b"model" * 100)
    result = directory.read_result()
    directory.finish(result.steps, result.metrics)
    sync(directory)
    return directory


def half(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def changed(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGES = {"emptied": lambda path: path.write_bytes(b""), "half": half, "changed": changed}
FILES = (
    "metrics.jsonl",
    "episodes.csv",
    "models/final.zip",
    "config.yaml",
    "checkpoints/step=0000000020/model.zip",
)


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_of_a_finished_run_does_not_replace_what_the_store_has(
    finished, name, damage
):
    before = stored_files(finished)
    metrics = rows(finished.output_dir, "SELECT count(*) FROM metrics")
    DAMAGES[damage](finished.path / name)
    synced = sync_stored(finished.output_dir, code=2)
    assert name.rpartition("/")[2] in synced.stderr
    assert "files and store differ for 1 run" in synced.stderr
    assert stored_files(finished) == before
    assert rows(finished.output_dir, "SELECT count(*) FROM metrics") == metrics
    assert rows(finished.output_dir, "SELECT status FROM runs") == [("FINISHED",)]


def test_a_run_whose_damaged_file_is_restored_or_deleted_is_whole_again(finished):
    path = finished.path / "metrics.jsonl"
    content = path.read_bytes()
    for mend in (lambda: path.write_bytes(content), path.unlink):
        half(path)
        store = Store(finished.tracking_uri, finished.output_dir)
        problem = complete_store([finished], store)
        assert "metrics.jsonl changed after the run was finished" in problem
        mend()
        sync_stored(finished.output_dir)
        assert stored_files(finished)["metrics.jsonl"] == content


def test_a_damaged_file_does_not_get_into_a_new_store(finished, empty):
    half(finished.path / "episodes.csv")
    shutil.copy(empty / "mlflow.db", finished.output_dir)
    shutil.rmtree(finished.output_dir / "mlflow-artifacts")
    with pytest.raises(StoreError, match=r"^episodes\.csv changed after the run was finished"):
        sync(finished)
    assert rows(finished.output_dir, "SELECT count(*) FROM runs") == [(0,)]


@pytest.mark.parametrize("damage", ["emptied", "half"])
@pytest.mark.parametrize("name", ["episodes.csv", "summary.json"])
def test_a_damaged_file_of_an_evaluation_does_not_replace_what_the_store_has(
    finished, name, damage
):
    folder = finished.path / "evaluations" / "again"
    folder.mkdir(parents=True)
    (folder / "episodes.csv").write_text("episode,success\n0,1\n")
    sync(finished)
    assert "evaluations/again/episodes.csv" not in stored_files(finished)  # it is under way
    write_summary(folder, {"success_rate": 1.0})
    sync(finished)
    before = stored_files(finished)
    assert {"evaluations/again/episodes.csv", "evaluations/again/summary.json"} < set(before)
    DAMAGES[damage](folder / name)
    synced = sync_stored(finished.output_dir, code=2)
    assert (
        f"evaluations/again/{name} changed after the run was finished; the store keeps what it has"
        in synced.stderr
    )
    assert stored_files(finished) == before


@pytest.mark.parametrize("uri", ["sqlite:///{output_dir}/mlflow.db", "sqlite:///mlflow.db"])
def test_a_store_that_is_named_twice_is_synced_once(finished, uri):
    half(finished.path / "metrics.jsonl")
    chosen = f"tracking.uri={uri.format(output_dir=finished.output_dir)}"
    options = (f"output_dir={finished.output_dir}", "sync=true", chosen)
    synced = call_script("status", *options, cwd=finished.output_dir)
    assert synced.stderr.count("metrics.jsonl changed after the run was finished") == 1
    assert "files and store differ for 1 run;" in synced.stderr


def test_a_status_that_can_t_be_read_is_a_problem_of_a_sync(finished):
    (finished.path / "status.json").write_text("")
    synced = sync_stored(finished.output_dir, code=2)
    assert f"{finished.path}: status.json can't be read" in synced.stderr
    assert rows(finished.output_dir, "SELECT status FROM runs") == [("FINISHED",)]


@pytest.mark.parametrize("lost", [".", "smoke", "smoke/{run_id}/artifacts/metrics.jsonl"])
def test_lost_artifacts_are_sent_again(finished, lost):
    before = stored_files(finished)
    path = finished.output_dir / "mlflow-artifacts" / lost.format(run_id=finished.run_id)
    if path.is_dir():
        shutil.rmtree(path)
    else:
        half(path)
    synced = sync_stored(finished.output_dir)
    assert synced.stderr == f"{finished.path}: the store has everything\n"
    assert stored_files(finished) == before


def test_a_run_is_done_in_the_store_once_all_of_it_is_there(output_dir, monkeypatch):
    first, last = finished_run(output_dir), written_run(output_dir, seed=1)
    sync(first)
    with last.training_lock():
        sync(last)
    content = (first.path / "metrics.jsonl").read_bytes()
    (last.path / "metrics.jsonl").write_bytes(content)
    (last.path / "episodes.csv").write_text("phase,step\n")
    result = first.read_result()
    last.finish(result.steps, result.metrics)
    seen = []
    put = Store.put_artifact

    def put_and_look(self, run, name, content):
        put(self, run, name, content)
        seen.append(load("smoke", output_dir=output_dir).runs["status"].tolist())

    monkeypatch.setattr(Store, "put_artifact", put_and_look)
    sync(last)
    assert seen == [["done", "running"]] * len(seen)
    assert len(seen) > 2
    assert load("smoke", output_dir=output_dir).runs["status"].tolist() == ["done", "done"]


def test_a_finished_run_has_its_success_rate_in_front_of_its_name(output_dir):
    directory = finished_run(output_dir)
    directory.update_status(success_rate=0.9876)
    sync(directory)
    config, client = directory.read_config(), store(output_dir)
    assert client.get_run(directory.run_id).info.run_name == f"98.8% {config.cell_name}-seed=0"
    client.update_run(directory.run_id, name="mine")
    directory.update_status(command="another")
    sync(directory)
    assert client.get_run(directory.run_id).info.run_name == "mine"


def test_an_experiment_that_was_deleted_in_mlflow_is_named_by_all_commands(finished):
    output_dir = finished.output_dir
    client = store(output_dir)
    experiment_id = client.get_experiment_by_name("smoke").experiment_id
    client.delete_experiment(experiment_id)
    sentence = (
        f"mlflow experiments restore --experiment-id {experiment_id}`, or choose another name"
    )
    synced = sync_stored(output_dir, code=2)
    assert (
        f"{finished.path}: experiment=smoke is deleted in MLflow; restore it by " in synced.stderr
    )
    assert sentence in synced.stderr
    reported = call_script("report", f"output_dir={output_dir}", "experiment=smoke", code=2)
    assert sentence in reported.stderr
    client.restore_experiment(experiment_id)
    sync_stored(output_dir)
    assert artifacts(client, finished.run_id) == sorted(stored_files(finished))


def test_result_json_has_the_hashes_of_what_no_longer_changes(finished):
    hashes = json.loads((finished.path / "result.json").read_text())["sha256"]
    assert set(hashes) == set(FILES)
    assert changed_files(finished.path) == []


def test_without_the_hashes_of_a_result_changed_files_are_not_sent(finished):
    before = stored_files(finished)
    (finished.path / "metrics.jsonl").write_text("")
    (finished.path / "result.json").write_text("")
    synced = sync_stored(finished.output_dir, code=2)
    assert "result.json has no hashes to check them; the store keeps what it has" in synced.stderr
    assert stored_files(finished) == before


@pytest.mark.parametrize("status", ["pending", "running", "interrupted", "failed"])
def test_a_run_that_is_evaluated_again_keeps_its_results_in_the_store_until_that_is_done(
    finished, status
):
    before, run_id, result = stored_files(finished), finished.run_id, finished.read_result()
    finished.reopen()
    sync(finished)
    write_json(finished.path / "provenance.json", {"started_ms": 1_800_000_000_000, "tags": {}})
    finished.update_status(status=status)
    sync(finished)
    assert finished.run_id == run_id
    assert stored_files(finished) == before
    assert load("smoke", output_dir=finished.output_dir).runs["status"].tolist() == ["done"]
    finished.finish(result.steps, result.metrics)
    sync(finished)
    assert finished.run_id != run_id
    assert load("smoke", output_dir=finished.output_dir).runs["status"].tolist() == ["done"]
