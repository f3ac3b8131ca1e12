"""The thread of a sweep that syncs its runs."""

from support.sweep_processes import wait_until
from support.tracked_runs import finished_run, written_run

from parking_exp.sweeps import store_thread
from parking_exp.tracking.store_writer import StoreWriter


def test_a_run_that_can_not_be_synced_keeps_no_other_run_from_the_store(output_dir, monkeypatch):
    monkeypatch.setattr(store_thread, "POLL_S", 0.01)
    damaged, whole = [finished_run(output_dir, seed) for seed in range(2)]
    (damaged.path / "episodes.csv").write_text("")
    waiting = written_run(output_dir, seed=2)  # without a checkpoint
    paths = []
    messages = []
    writer = StoreWriter([whole.config()], messages.append)

    with store_thread.syncing(lambda: paths, writer):
        paths += [damaged.path, waiting.path, whole.path]
        wait_until(lambda: whole.run_id is not None, timeout=store_thread.PAUSE_S / 2)
        assert [*writer.problems] == [damaged.path]
        assert waiting.run_id is None

    incomplete, missing = messages
    problem = "episodes.csv changed after the run was finished"
    assert incomplete.startswith(f"the store {whole.tracking_uri} is incomplete ({problem}")
    assert missing.startswith(f"files and store differ for 1 run, e.g. {damaged.path}: {problem}")
