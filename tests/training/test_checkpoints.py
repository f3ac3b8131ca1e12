"""Checkpoints are whole or not there, and bring everything back."""

import errno
import json

import numpy as np
import pytest
import torch
from stable_baselines3.common.logger import Logger
from support.runs import make_config

from parking_exp.algorithms.build_model import build_model
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import DamagedFileError
from parking_exp.runs.metric_logs import APPENDED, copy_logs, read_metrics, restore_logs
from parking_exp.training import checkpoints
from parking_exp.training.checkpoints import Progress


def trained(*overrides, steps=100):
    config = make_config("experiment=smoke", "algorithm.learning_starts=40", *overrides)
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    model.set_logger(Logger(None, []))
    if steps:
        model.learn(steps)
    return model


def save(directory, model, step, keep_last=2, best=None):
    return checkpoints.save(directory, model, Progress(step=step), best or directory / "no-best.zip", keep_last)


def assert_same_arrays(one, two):
    assert one.keys() == two.keys()
    for name in one:
        assert (one[name].dtype, one[name].shape) == (two[name].dtype, two[name].shape), name
        assert one[name].tobytes() == two[name].tobytes(), name


def test_buffer_and_counters_come_back(tmp_path):
    """And the model: tests/algorithms/test_contract.py shows that of every algorithm."""
    model, fresh = trained(), trained(steps=0)
    folder = save(tmp_path, model, step=100)
    checkpoints.restore(folder, fresh, best=tmp_path / "best.zip")
    for name in ("num_timesteps", "_n_updates", "_episode_num"):
        assert getattr(fresh, name) == getattr(model, name) > 0
    assert list(fresh.ep_success_buffer) == list(model.ep_success_buffer)
    assert_same_arrays(model.replay_buffer.get_state(), fresh.replay_buffer.get_state())
    assert_same_arrays(model._last_obs, fresh._last_obs)


SB3_HER = (
    "buffer._target_=stable_baselines3.HerReplayBuffer",
    "~buffer.relabel_collision",
    "~buffer.relabel_terminated",
    "~buffer.goal_velocity",
)


@pytest.mark.parametrize("overrides", [("buffer=replay",), SB3_HER])
def test_a_full_buffer_comes_back_too(tmp_path, overrides):
    """Ours, and any of Stable-Baselines3's."""
    small = ("buffer.buffer_size=60", *overrides)
    model, fresh = trained(*small), trained(*small, steps=0)
    checkpoints.restore(save(tmp_path, model, step=100), fresh, best=tmp_path / "best.zip")
    ours, theirs = model.replay_buffer, fresh.replay_buffer
    assert theirs.full
    assert theirs.pos == ours.pos
    samples = []
    for buffer in (ours, theirs):
        np.random.seed(0)
        buffer.rng = np.random.default_rng(0)
        samples.append(buffer.sample(50))
    assert torch.equal(samples[0].rewards, samples[1].rewards)


@pytest.mark.parametrize("overrides", [(), SB3_HER])
def test_episodes_under_way_stay_under_way(tmp_path, overrides):
    model, fresh = trained(*overrides, steps=105), trained(*overrides, steps=0)
    checkpoints.restore(save(tmp_path, model, step=105), fresh, best=tmp_path / "best.zip")
    if overrides:
        for buffer in (model.replay_buffer, fresh.replay_buffer):
            assert (buffer._current_ep_start != buffer.pos).all()
        assert (fresh.replay_buffer.ep_length == model.replay_buffer.ep_length).all()
    else:
        for episodes in (model.replay_buffer.episodes, fresh.replay_buffer.episodes):
            assert (episodes.current >= 0).all()


def test_only_the_filled_part_of_the_buffer_is_saved(tmp_path):
    model = trained("buffer.buffer_size=1000000")
    folder = save(tmp_path, model, step=100)
    assert (folder / checkpoints.BUFFER).stat().st_size < 100 * 500


def test_keep_last_bounds_what_is_on_disk(tmp_path):
    model = trained(steps=0)
    for step in (10, 20, 30, 40):
        save(tmp_path, model, step, keep_last=2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["step=0000000030", "step=0000000040"]
    assert sorted(path.name for path in (tmp_path / "step=0000000040").iterdir()) == [
        "manifest.json", "metrics.jsonl", "model.zip", "replay_buffer.npz", "state.json", "state.npz",
    ]  # fmt: skip


def test_a_corrupt_checkpoint_never_outlives_a_whole_one(tmp_path):
    model = trained(steps=0)
    save(tmp_path, model, 100, keep_last=1)
    corrupt = save(tmp_path, model, 200, keep_last=1)
    (corrupt / "model.zip").write_bytes(b"")
    assert checkpoints.latest(tmp_path) is None
    assert save(tmp_path, model, 100, keep_last=1) == checkpoints.latest(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["step=0000000100"]


def test_checkpoints_sort_by_step_not_by_name(tmp_path):
    model = trained(steps=0)
    for step in (900, 1000, 100_000):
        save(tmp_path, model, step, keep_last=3)
    assert checkpoints.latest(tmp_path).name == "step=0000100000"


@pytest.mark.parametrize("name", ["model.zip", "replay_buffer.npz", "state.json", "state.npz"])
@pytest.mark.parametrize("damage", ["truncated", "changed", "missing"])
def test_a_damaged_checkpoint_is_recognised(tmp_path, name, damage):
    model = trained(steps=0)
    older, newer = save(tmp_path, model, 10), save(tmp_path, model, 20)
    assert checkpoints.latest(tmp_path) == newer
    content = bytearray((newer / name).read_bytes())
    if damage == "missing":
        (newer / name).unlink()
    elif damage == "truncated":
        (newer / name).write_bytes(content[: len(content) // 2])
    else:
        content[len(content) // 2] ^= 1
        (newer / name).write_bytes(content)
    assert checkpoints.latest(tmp_path) == older


@pytest.mark.parametrize("manifest", [None, b"", b'{"model.zip"', b"{}", b"[]", b"\xff\xfe"])
def test_a_checkpoint_without_its_manifest_does_not_count(tmp_path, manifest):
    folder = save(tmp_path, trained(steps=0), 10)
    (folder / "manifest.json").unlink()
    if manifest is not None:
        (folder / "manifest.json").write_bytes(manifest)
    assert checkpoints.latest(tmp_path) is None


def test_a_checkpoint_whose_manifest_lacks_a_file_does_not_count(tmp_path):
    folder = save(tmp_path, trained(steps=0), 10)
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["state.npz"]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert checkpoints.latest(tmp_path) is None


@pytest.mark.parametrize("written", range(5))
def test_a_full_disk_at_any_file_leaves_the_earlier_checkpoint_and_no_rest(tmp_path, monkeypatch, written):
    """Each of the files meets the disk when it is synced."""
    model = trained(steps=0)
    older, synced = save(tmp_path, model, 10), []

    def fsync(path):
        synced.append(path)
        if len(synced) > written:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(checkpoints, "fsync", fsync)
    with pytest.raises(OSError, match="No space left"):
        save(tmp_path, model, 20)
    assert list(tmp_path.iterdir()) == [older]
    assert checkpoints.latest(tmp_path) == older


def test_a_failed_write_leaves_the_earlier_checkpoint_and_no_rest(tmp_path, monkeypatch):
    model = trained(steps=0)
    older = save(tmp_path, model, 10)
    # A value that JSON can't hold stands in for an error in the middle of writing.
    monkeypatch.setattr(model, "num_timesteps", object())
    with pytest.raises(TypeError):
        save(tmp_path, model, 20)
    assert list(tmp_path.iterdir()) == [older]


def test_leftovers_of_a_killed_write_are_cleared_away(tmp_path):
    (tmp_path / ".tmp-step=0000000005").mkdir()
    (tmp_path / ".tmp-step=0000000005" / "model.zip").write_bytes(b"half")
    folder = save(tmp_path, trained(steps=0), 10)
    assert list(tmp_path.iterdir()) == [folder]


def test_the_best_model_goes_back_with_the_checkpoint(tmp_path):
    model, best = trained(steps=0), tmp_path / "best.zip"
    best.write_bytes(b"best so far")
    folder = save(tmp_path / "checkpoints", model, 10, best=best)
    best.write_bytes(b"a later one, from steps that are going to be done again")
    checkpoints.restore(folder, model, best=best)
    assert best.read_bytes() == b"best so far"


def test_restoring_unpickles_nothing(tmp_path, monkeypatch):
    model, fresh = trained(), trained(steps=0)
    folder = save(tmp_path, model, 100)
    for name in ("pickle.load", "pickle.loads", "cloudpickle.load", "cloudpickle.loads"):
        monkeypatch.setattr(name, lambda *_, **__: pytest.fail("unpickled"))
    checkpoints.restore(folder, fresh, best=tmp_path / "best.zip")
    assert fresh.num_timesteps == 100


@pytest.fixture
def logs(tmp_path):
    """A run directory with logs, and a checkpoint that has metrics and episodes but no monitor.csv yet."""
    checkpoint = tmp_path / "checkpoint"
    checkpoint.mkdir()
    for name in ("metrics.jsonl", "episodes.csv"):
        (tmp_path / name).write_text(f"{name}: kept\n")
    copy_logs(tmp_path, checkpoint)
    return tmp_path, checkpoint


def test_logs_are_cut_back_to_the_checkpoint(logs):
    run_dir, checkpoint = logs
    for name in APPENDED:
        with (run_dir / name).open("a") as file:
            file.write("half a l")
    restore_logs(run_dir, checkpoint)
    for name in ("metrics.jsonl", "episodes.csv"):
        assert (run_dir / name).read_text() == f"{name}: kept\n"
    assert not (run_dir / "monitor.csv").exists()  # it did not exist yet at the checkpoint


def test_without_a_checkpoint_logs_begin_anew(logs):
    run_dir, _ = logs
    restore_logs(run_dir, None)
    assert not any((run_dir / name).exists() for name in APPENDED)


@pytest.mark.parametrize("line", ["{", "[]", "3", '{"step": 1}', '{"step": 1, "time_ms": 1, "metrics": 3}', "\x00" * 9])
def test_a_damaged_row_of_metrics_is_named(tmp_path, line):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"step": 1, "time_ms": 1, "metrics": {"a": 1.0}}\n' + line + "\n")
    with pytest.raises(DamagedFileError) as refusal:
        list(read_metrics(path))
    assert str(refusal.value) == f"{path} is damaged: line 2 is no row of metrics"
