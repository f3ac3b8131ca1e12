"""Output directories that were moved or copied, and run directories from elsewhere: what is written
where.
"""

import json
import shutil
import socket

import pytest
import yaml
from support.runs import call_script, evaluate_stored, names_in, run_script, store, sync_stored
from support.sync_processes import sync
from support.tracked_runs import files_below, finished_run, rows

from parking_exp.config.compose import compose
from parking_exp.config.paths import default_uri
from parking_exp.errors import ParkingError, StoreError, UntrustedError
from parking_exp.results.frames import load
from parking_exp.runs.atomic_files import write_json
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import read_json
from parking_exp.runs.lookup import find_runs
from parking_exp.sweeps.single_run import train
from parking_exp.tracking.store import Store
from parking_exp.tracking.sync import sync_missing, sync_run

EVALUATE = ("episodes=1", "simulator=vectorized", "name=again")


@pytest.mark.slow
@pytest.mark.parametrize("move", [shutil.move, shutil.copytree])
def test_a_moved_or_copied_output_directory_works_in_its_new_place_and_changes_nothing_else(
    tmp_path, move
):
    old = tmp_path / "old"
    new = tmp_path / "new"
    run_script("train", "experiment=smoke", f"output_dir={old}", code=0)
    move(old, new)
    before = files_below(tmp_path / "old")
    (path,) = find_runs(new)
    run_id = RunDirectory(path).run_id
    done = run_script("evaluate", f"run={path}", f"output_dir={new}", *EVALUATE, code=0)
    assert "not stored" not in done.stdout
    assert files_below(old) == before
    assert (
        "mlflow.db can't be used here and is made again; the old one is mlflow.db.replaced-1\n"
        in done.stderr
    )
    assert rows(new, "SELECT run_uuid FROM runs") != [(run_id,)]
    run_id = RunDirectory(path).run_id
    assert rows(new, "SELECT run_uuid, lifecycle_stage FROM runs") == [(run_id, "active")]
    assert (
        new / "mlflow-artifacts" / "smoke" / run_id / "artifacts" / "evaluations" / "again"
    ).is_dir()
    results = load("smoke", output_dir=new)
    assert results.runs["run_dir"].tolist() == [str(path)]
    assert results.problems == ()
    synced = run_script("status", f"output_dir={new}", "sync=true", code=0)
    assert synced.stderr == ""


def test_files_of_a_run_directory_do_not_name_the_output_directory(smoke, smoke_folder):
    output_dir = smoke_folder / "outputs"
    exceptions = {"status.json": ("command",)}
    for name in ("config.yaml", "status.json", "result.json", "provenance.json"):
        content = yaml.safe_load((smoke.path / name).read_text())
        rest = {key: value for key, value in content.items() if key not in exceptions.get(name, ())}
        assert str(output_dir) not in json.dumps(rest), name
    assert read_json(smoke.path / "status.json")["tracking_uri"] == "sqlite:///mlflow.db"
    assert smoke.tracking_uri == default_uri(output_dir)
    assert smoke.read_config().output_path == output_dir


@pytest.fixture
def listener():
    """Somebody else's server: its socket, which is not to be connected to."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        yield server
        with pytest.raises(BlockingIOError):
            server.accept()


def uri_of(server):
    return f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture
def foreign(smoke, tmp_path):
    """A copy of a finished run directory, alone, as it may come from elsewhere."""
    path = tmp_path / "theirs" / "experiment" / "cell" / "seed=0"
    shutil.copytree(smoke.path, path)
    return RunDirectory(path)


def test_evaluating_and_syncing_do_not_connect_to_the_store_that_a_run_directory_names(
    foreign, listener, tmp_path, monkeypatch
):
    uri = uri_of(listener)
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "secret-token")
    foreign.update_status(tracking_uri=uri)
    done = call_script("evaluate", f"run={foreign.path}", *EVALUATE, cwd=tmp_path, code=0)
    assert f"tracking.uri={uri} sends the results there" in done.stdout
    assert (foreign.path / "evaluations" / "again" / "summary.json").exists()
    assert names_in(tmp_path) == ["theirs"]
    done = sync_stored(tmp_path / "theirs")
    assert f"tracking.uri={uri}" in done.stderr


@pytest.mark.parametrize("name", ["evaluations", "evaluations/again/episodes.csv", "video.mp4"])
def test_links_that_lead_out_of_a_run_directory_are_refused(foreign, tmp_path, name):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "episodes.csv").write_text("content")
    link = foreign.path / name
    shutil.rmtree(foreign.path / "evaluations", ignore_errors=True)
    link.unlink(missing_ok=True)
    link.parent.mkdir(exist_ok=True, parents=True)
    link.symlink_to(outside if "." not in link.name else outside / "episodes.csv")
    before = files_below(outside)
    with pytest.raises(UntrustedError) as refusal:
        evaluate_stored(foreign.path, *EVALUATE)
    assert str(link) in str(refusal.value)
    assert files_below(outside) == before
    with pytest.raises(UntrustedError, match="is a symbolic link"):
        sync_run(foreign, Store(default_uri(tmp_path), foreign.output_dir))


@pytest.mark.parametrize(
    "place", ["file:///etc/parking", "s3://bucket/x", "./mlruns/0", "{listener}/x"]
)
def test_artifacts_of_an_embedded_store_are_neither_sent_elsewhere_nor_read_there(
    output_dir, listener, place, monkeypatch
):
    place = place.format(listener=uri_of(listener))
    monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", "secret-token")
    directory, late = finished_run(output_dir), finished_run(output_dir, seed=1)
    sync(directory)
    rows(output_dir, "UPDATE runs SET artifact_uri = ?", place)
    assert len(load("smoke", output_dir=output_dir).problems) == 4  # one of each file
    rows(output_dir, "UPDATE experiments SET artifact_location = ? WHERE name = 'smoke'", place)
    with pytest.raises(StoreError, match="artifacts outside of") as refusal:
        sync(late)
    assert place in str(refusal.value)
    assert rows(output_dir, "SELECT count(*) FROM runs") == [(1,)]


def test_a_store_that_is_a_link_out_of_its_output_directory_is_refused(output_dir, tmp_path):
    directory = finished_run(output_dir)
    shutil.move(output_dir / "mlflow.db", tmp_path / "elsewhere.db")
    (output_dir / "mlflow.db").symlink_to(tmp_path / "elsewhere.db")
    before = (tmp_path / "elsewhere.db").read_bytes()
    ((_, problem),) = sync_missing([directory], Store(default_uri(output_dir), output_dir))
    assert f"{output_dir / 'mlflow.db'} is a symbolic link" in problem
    with pytest.raises(ParkingError, match="is a symbolic link"):
        load("smoke", output_dir=output_dir)
    assert (tmp_path / "elsewhere.db").read_bytes() == before


@pytest.mark.parametrize("named_in", ["status.json", "provenance.json"])
def test_a_foreign_directory_cannot_take_another_run_of_the_store(output_dir, named_in):
    victim, directory = finished_run(output_dir, seed=1), finished_run(output_dir, seed=2)
    sync(victim)
    client = store(output_dir)
    before = client.get_run(victim.run_id)
    tags = {
        "run_key": victim.read_config().run_key,
        "run_dir": str(victim.path.relative_to(output_dir)),
        "cpu": 5,
    }
    if named_in == "status.json":
        directory.update_status(run_id=victim.run_id)
    else:
        write_json(
            directory.path / named_in, {"started_ms": 5, "tags": {**tags, "version.torch": "9"}}
        )
    sync(directory)
    assert directory.run_id != victim.run_id
    after, stored = (client.get_run(run.run_id) for run in (victim, directory))
    assert (after.info.lifecycle_stage, after.data.tags) == ("active", before.data.tags)
    assert stored.data.tags["run_key"] == directory.read_config().run_key
    if named_in == "provenance.json":
        assert stored.data.tags["version.torch"] == "9"
        assert stored.data.tags["cpu"] == "5"


def test_a_training_does_not_write_through_links(tmp_path):
    config = compose(
        "experiment=smoke", f"output_dir={tmp_path / 'outputs'}", "tracking.mlflow=false"
    )
    directory, outside = RunDirectory(config.run_dir), tmp_path / "file"
    directory.write_config(config)
    outside.write_text("content")
    (directory.path / "metrics.jsonl").symlink_to(outside)
    with pytest.raises(UntrustedError, match="is a symbolic link that leads out of /"):
        train(config)
    assert outside.read_text() == "content"
