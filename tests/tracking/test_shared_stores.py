"""Several output directories with one store: each changes its own runs only."""

import shutil
from concurrent.futures import ThreadPoolExecutor

import pytest
from support.runs import artifacts, call_script, sync_stored
from support.sync_processes import sync
from support.tracked_runs import finished_run

from parking_exp.errors import OutputDirectoryError
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.file_hashes import write_summary
from parking_exp.runs.output_identity import output_id
from parking_exp.tracking.store import Store


@pytest.fixture
def central(empty, tmp_path):
    """The URI of a store that is in no output directory."""
    return f"sqlite:///{shutil.copy(empty / 'mlflow.db', tmp_path / 'central.db')}"


def stages(uri):
    """Lifecycle stage and start of all stored runs."""
    store = Store(uri, None)
    runs = store.search([*store.experiment_ids().values()])
    return sorted((run.info.start_time, run.info.lifecycle_stage) for run in runs)


def test_machines_with_the_same_path_of_the_output_directory_keep_each_others_runs(
    central, tmp_path
):
    path = tmp_path / "outputs"
    for number in range(2):  # two containers: the path is the same, the directory is not
        sync(finished_run(path, uri=central, started_ms=1000 + number))
        shutil.move(path, tmp_path / f"machine-{number}")
    for number in (0, 1, 0):
        shutil.move(tmp_path / f"machine-{number}", path)
        synced = sync_stored(path, f"tracking.uri={central}")
        assert synced.stderr == ""
        shutil.move(path, tmp_path / f"machine-{number}")
    assert stages(central) == [(1000, "active"), (1001, "active")]


def test_a_run_that_is_trained_again_replaces_that_of_its_own_output_directory(central, tmp_path):
    path = tmp_path / "outputs"
    for started_ms in (1000, 2000):
        directory = finished_run(path, uri=central, started_ms=started_ms)
        sync(directory)
        shutil.rmtree(directory.path)
    assert stages(central) == [(1000, "deleted"), (2000, "active")]


def test_a_run_without_an_owner_is_taken_by_the_same_training_alone(central, tmp_path):
    directory = finished_run(tmp_path / "outputs", uri=central, started_ms=1000)
    sync(directory)
    client = Store(central, None).client
    client.delete_tag(directory.run_id, "output_id")  # as earlier versions left it
    run_id = directory.run_id
    directory.update_status(command="another")
    sync(directory)
    assert directory.run_id == run_id
    client.delete_tag(run_id, "output_id")
    shutil.rmtree(directory.path)
    sync(finished_run(tmp_path / "outputs", uri=central, started_ms=2000))
    assert stages(central) == [(1000, "active"), (2000, "active")]


def test_a_moved_output_directory_keeps_its_runs_and_a_copy_gets_its_own(central, tmp_path):
    directory = finished_run(tmp_path / "one", uri=central)
    sync(directory)
    run_id = directory.run_id
    shutil.copytree(tmp_path / "one", tmp_path / "two")
    copy = RunDirectory(tmp_path / "two" / directory.path.relative_to(tmp_path / "one"))
    evaluation = copy.path / "evaluations" / "again"
    evaluation.mkdir(parents=True)
    write_summary(evaluation, {"episodes": 1})
    sync(copy)
    assert copy.run_id != run_id
    client = Store(central, None).client
    assert artifacts(client, run_id, "evaluations") == []
    assert artifacts(client, copy.run_id, "evaluations") == ["evaluations/again/summary.json"]
    shutil.move(tmp_path / "one", tmp_path / "three")
    moved = RunDirectory(tmp_path / "three" / directory.path.relative_to(tmp_path / "one"))
    sync(moved)
    assert moved.run_id == run_id
    run_dir = client.get_run(run_id).data.tags["run_dir"]
    assert run_dir == str(moved.path.relative_to(tmp_path))
    assert len(stages(central)) == 2


def test_an_identity_is_made_once_and_a_damaged_one_is_refused(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        assert len(set(pool.map(output_id, [tmp_path] * 8))) == 1
    (tmp_path / "identity.json").write_text("{")
    with pytest.raises(OutputDirectoryError, match=r"identity\.json is damaged"):
        output_id(tmp_path)


def test_a_finished_run_that_is_typed_with_another_store_is_sent_there(smoke_copy, central):
    command = ("experiment=smoke", f"output_dir={smoke_copy.output_dir}", f"tracking.uri={central}")
    done = call_script("train", *command)
    assert "already done" in done.stdout
    assert smoke_copy.tracking_uri == central
    assert [stage for _, stage in stages(central)] == ["active"]
    call_script("train", *command[:2], "seed=0,0", "--dry-run", code=0)
    assert smoke_copy.tracking_uri == central


def test_a_sweep_sends_its_finished_runs_to_another_store_too(smoke_copy, central):
    command = (
        "experiment=smoke",
        f"output_dir={smoke_copy.output_dir}",
        "retry=failed",
        f"tracking.uri={central}",
    )
    call_script("train", *command, code=0)
    assert [stage for _, stage in stages(central)] == ["active"]


def test_mlflows_variable_is_said_to_be_ignored(smoke_copy, monkeypatch):
    from parking_exp.tracking.client import say_ignored_store

    monkeypatch.setenv("MLFLOW_TRACKING_URI", "http://127.0.0.1:9")
    say_ignored_store.cache_clear()
    synced = sync_stored(smoke_copy.output_dir)
    sentence = (
        "MLFLOW_TRACKING_URI is ignored; tracking.uri=URI chooses a store other than output_dir's"
    )
    assert synced.stderr.splitlines()[-1] == sentence
    say_ignored_store.cache_clear()
