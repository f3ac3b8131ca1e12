"""The writer of a command's runs: what it does about a store that fails."""

from types import SimpleNamespace

from support.sweep_processes import wait_until
from support.tracked_runs import finished_run, written_run

from parking_exp.tracking import store_writer
from parking_exp.tracking.store_writer import StoreWriter
from parking_exp.tracking.sync import sync_hint


def test_a_failed_store_is_named_once_and_a_run_tries_it_again_after_a_pause(
    output_dir, monkeypatch
):
    blocked = output_dir / "blocked"
    blocked.touch()  # a file where the database's folder is to be
    uri = f"sqlite:///{blocked / 'mlflow.db'}"
    first, second, third = [written_run(output_dir, seed, uri) for seed in range(3)]
    clock = SimpleNamespace(monotonic=lambda: 1000.0)
    monkeypatch.setattr(store_writer, "time", clock)
    messages = []
    writer = StoreWriter([first.read_config()], messages.append)
    assert not writer.has_failed
    writer.sync(first)
    writer.sync(second)
    assert writer.has_failed
    problem = f"[Errno 17] File exists: '{blocked}'"
    hint = sync_hint(output_dir, uri)
    expected = f"the store {uri} is incomplete ({problem}); training continues, and {hint}"
    assert messages == [expected]

    blocked.unlink()
    writer.sync(first)
    first.update_status(status="interrupted")
    writer.sync(first)
    assert first.run_id is None
    clock.monotonic = lambda: 1000.0 + store_writer.PAUSE_S
    writer.sync(first)
    assert first.run_id is not None
    writer.sync(third)
    assert third.run_id is not None
    writer.complete_stores([first, second, third])
    assert second.run_id is not None
    assert messages == [expected]


def test_a_run_that_can_not_be_synced_keeps_no_other_run_from_the_store(output_dir, monkeypatch):
    monkeypatch.setattr(store_writer, "POLL_S", 0.01)
    damaged, whole = [finished_run(output_dir, seed) for seed in range(2)]
    (damaged.path / "episodes.csv").write_text("")
    waiting = written_run(output_dir, seed=2)  # without a checkpoint
    paths = []
    messages = []
    writer = StoreWriter([whole.read_config()], messages.append)

    with writer.syncing(lambda: paths):
        paths += [damaged.path, waiting.path, whole.path]
        wait_until(lambda: whole.run_id is not None, timeout=30)
        assert waiting.run_id is None

    incomplete, missing = messages
    problem = "episodes.csv changed after the run was finished"
    assert incomplete.startswith(f"the store {whole.tracking_uri} is incomplete ({problem}")
    assert missing.startswith(f"files and store differ for 1 run, e.g. {damaged.path}: {problem}")
