"""Checkpoints are complete or absent, and restore everything."""

import errno

import pytest
from support.models import make_model
from support.runs import names_in

from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.runs.checkpoint_files import find_checkpoints
from parking_exp.training import checkpoints
from parking_exp.training.checkpoints import SavedProgress


def test_checkpoints_are_in_the_order_of_their_steps_and_copies_are_none(tmp_path):
    for name in ("step=10000000000", "step=9999999999", "step=9999999999.bak"):
        (tmp_path / name).mkdir()
    found = [path.name for path in find_checkpoints(tmp_path)]
    assert found == ["step=9999999999", "step=10000000000"]


def untrained(*overrides):
    return make_model("experiment=smoke", "algorithm.learning_starts=40", *overrides)


@pytest.fixture(scope="module")
def model():
    return untrained()


def save(directory, model, step, keep_last=2, best=None):
    best = best or directory / "no-best.zip"
    progress = SavedProgress(step=step)
    return checkpoints.save(directory, model, PolicyEMA(model, None), progress, best, keep_last)


def restore(folder, model, best):
    return checkpoints.restore(folder, model, PolicyEMA(model, None), best)


SB3_HER = (
    "buffer._target_=stable_baselines3.HerReplayBuffer",
    "~buffer.relabel_collision",
    "~buffer.relabel_terminated",
    "~buffer.goal_velocity",
)


@pytest.mark.filterwarnings("ignore:The last trajectory")
def test_transitions_of_stable_baselines3s_buffer_end_the_episodes_under_way(tmp_path):
    model = untrained(*SB3_HER).learn(105)
    fresh = untrained(*SB3_HER).replay_buffer
    folder = save(tmp_path, model, step=105)
    checkpoints.load_transitions(folder / checkpoints.BUFFER, fresh)

    buffer = model.replay_buffer
    assert (buffer._current_ep_start != buffer.pos).all()
    assert fresh.pos == buffer.pos > 0
    assert (fresh._current_ep_start == fresh.pos).all()
    assert fresh.timeouts[fresh.pos - 1].all()
    assert (fresh.ep_length[: fresh.pos] > 0).all()


def test_keep_last_limits_the_checkpoints_on_disk_by_step(tmp_path, model):
    (tmp_path / ".tmp-step=0000000005").mkdir()  # of a process that was killed
    for step in (10, 900, 1000, 100_000):
        save(tmp_path, model, step, keep_last=2)
    assert names_in(tmp_path) == [
        "step=0000001000",
        "step=0000100000",
    ]
    assert checkpoints.latest(tmp_path).name == "step=0000100000"
    assert names_in(checkpoints.latest(tmp_path)) == [
        "manifest.json", "metrics.jsonl", "model.zip", "replay_buffer.npz", "state.pt",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["model.zip", "state.pt", "manifest.json"])
@pytest.mark.parametrize("damage", ["truncated", "changed", "missing"])
def test_a_damaged_checkpoint_is_skipped_and_deleted_with_the_next_save(
    tmp_path, model, name, damage
):
    older, newer = save(tmp_path, model, 10), save(tmp_path, model, 20)
    assert checkpoints.latest(tmp_path) == newer
    content = bytearray((newer / name).read_bytes())
    content[0 if name == "manifest.json" else len(content) // 2] ^= 0x81
    if damage == "missing":
        (newer / name).unlink()
    else:
        (newer / name).write_bytes(content if damage == "changed" else content[: len(content) // 2])
    assert checkpoints.latest(tmp_path) == older
    assert save(tmp_path, model, 15, keep_last=1) == checkpoints.latest(tmp_path)
    assert names_in(tmp_path) == ["step=0000000015"]


@pytest.mark.parametrize("written", range(5))
def test_a_full_disk_at_any_file_leaves_only_the_earlier_checkpoint(
    tmp_path, model, monkeypatch, written
):
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
