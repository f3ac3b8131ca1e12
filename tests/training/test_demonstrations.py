"""Demonstrations: recorded once, a share of each batch, part of checkpoints and of the run key."""

import re
import shutil
from signal import SIGTERM

import numpy as np
import pytest
from filelock import FileLock
from support.interruptions import cut_at
from support.models import model_of
from support.run_equality import differences
from support.runs import only_run
from support.user_tasks import write_option

from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError, FailedRunError, InterruptedRunError, ModelError
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.training import demonstrations

SMOKE = (
    "experiment=smoke",
    "env=parking_parallel",
    "env.training_duration=null",
    "env.duration=40",
    "n_envs=1",
    "total_timesteps=260",
    "algorithm.learning_starts=200",
    "evaluation.every_n_steps=null",
    "evaluation.n_scenes=1",
    "evaluation.final_n_scenes=2",
    "evaluation.video_episodes=0",
    "evaluation.n_certified_scenes=0",
    "checkpoint.every_n_steps=230",
    "tracking.progress_bar=false",
    "tracking.mlflow=false",
    "buffer.demonstrations=3",
)


def configured(output_dir, *overrides):
    return compose(*SMOKE, *overrides, f"output_dir={output_dir}")


def demonstrated(config, on_progress=None):
    """The model of a config with its demonstrations, and their stats."""
    model = model_of(config)
    task = make_task(config.env)
    demonstrations.attach_demonstration_buffer(config, task, model)
    stats = demonstrations.add_demonstrations(config, task, model, on_progress or (lambda _: None))
    return model, stats


def demonstrations_of(config):
    model, _ = demonstrated(config)
    return model.replay_buffer.demonstrations


def test_they_are_episodes_of_the_last_training_scenes_in_which_the_planner_parks(tmp_path):
    config = configured(tmp_path)
    buffer = demonstrations_of(config)
    rows = buffer.storage.data[: buffer.episodes.steps, 0]
    ends = np.cumsum(buffer.episodes.table["length"][:3])
    assert ends[-1] == buffer.episodes.steps
    stored = buffer.storage.take(ends - 1)
    assert stored.terminated.tolist() == [True] * 3
    assert stored.failed.tolist() == [False] * 3

    seeds = config.env.training_seeds[-3:]
    first = make_task(config.env).evaluation_batch(seeds, None).observe()
    starts = np.concatenate([[0], ends[:-1]])
    for key, values in first.items():
        np.testing.assert_array_equal(buffer.storage.take(starts).obs[key], values)
    # Each step begins where the one before has ended.
    inside = np.setdiff1d(np.arange(1, len(rows)), starts)
    before = buffer.storage.take(inside - 1).next_obs["observation"]
    np.testing.assert_array_equal(before, buffer.storage.take(inside).obs["observation"])


@pytest.mark.parametrize("buffer", ["her_future", "replay"])
@pytest.mark.parametrize(("share", "expected"), [(0.25, 25), (0.5, 50), (0.996, 100)])
def test_a_share_of_each_batch_is_theirs(tmp_path, buffer, share, expected):
    config = configured(tmp_path, f"buffer={buffer}", f"buffer.demonstration_share={share}")
    model, _ = demonstrated(config)
    _train_a_little(model)
    batch = model.replay_buffer.sample(100)
    shown = model.replay_buffer.demonstrations.storage.data["action"][:, 0]
    is_shown = (batch.actions.numpy()[:, None] == shown[None]).all(axis=2).any(axis=1)
    assert is_shown.sum() == expected
    assert is_shown[100 - expected :].all()


def _train_a_little(model):
    model.learn(model.learning_starts)


def test_her_gives_them_virtual_goals(tmp_path):
    config = configured(tmp_path, "buffer.n_sampled_goal=4", "buffer.relabel_terminated=sb3")
    model, _ = demonstrated(config)
    _train_a_little(model)
    buffer = model.replay_buffer
    own_goals = buffer.demonstrations.episodes.table["goal"][:3]
    goals = buffer.sample(400).observations["desired_goal"].numpy()[-100:]
    is_real = (goals[:, None] == own_goals[None]).all(axis=2).any(axis=1)
    assert is_real.tolist() == [True] * 20 + [False] * 80


def test_the_runs_of_a_cell_share_a_file_and_each_counts_its_cpu_time(tmp_path):
    first = train(configured(tmp_path))
    (file,) = (tmp_path / "demonstrations").glob("*.npz")
    stored = dict(np.load(file))
    assert 0 < stored["cpu_s"] < first.metrics["time/cpu_s"] < 1000
    stored["cpu_s"] = np.array(1000.0)
    np.savez(file, **stored)
    second = train(configured(tmp_path, "seed=1"))
    assert second.metrics["time/cpu_s"] > 1000
    assert not any(name.startswith("certified/") for name in second.metrics)
    assert len(list((tmp_path / "demonstrations").glob("*.npz"))) == 1


def test_another_env_has_a_file_of_its_own(tmp_path):
    for overrides in ([], ["seed=1"], ["env.level=hard"]):
        demonstrated(configured(tmp_path, "buffer.demonstrations=1", *overrides))
    assert len(list((tmp_path / "demonstrations").glob("*.npz"))) == 2


def walked(output_dir, *overrides):
    """A config of a user's task, in which a policy of theirs demonstrates."""
    folder = write_option(output_dir / "my_conf", "support.user_policies.LongSteps")
    settings = ("total_timesteps=200", "n_envs=4", "algorithm.learning_starts=100")
    shown = ("buffer.demonstrations=4", "buffer.demonstrator._target_=support.user_policies.Walker")
    output = f"output_dir={output_dir}"
    return compose("env=steps", *settings, *shown, output, *overrides, config_dir=folder)


def test_a_users_policy_demonstrates_a_users_task_in_the_buffers_unit_of_actions(tmp_path):
    model, stats = demonstrated(walked(tmp_path))
    buffer = model.replay_buffer.demonstrations
    n_steps = buffer.episodes.steps
    assert stats.n_successes == 4
    # From 0, 1, 2 and 3 to 3, in a task whose actions go up to 2.
    assert buffer.episodes.table["length"][:4].tolist() == [3, 2, 1, 1]
    rows = buffer.storage.data[:n_steps, 0]
    assert rows["action"][:, 0].tolist() == [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.0]
    assert rows["reward"].tolist() == [-2, -1, 0, -1, 0, 0, 0]


def test_a_policy_that_fails_demonstrates_all_the_same(tmp_path):
    lazy = walked(tmp_path, "+buffer.demonstrator.stride=0.5", "buffer.demonstrations=8")
    _, stats = demonstrated(lazy)
    assert stats.n_successes == 6  # with 5 steps of a half, 3 is out of reach from 0


def test_timeouts_are_stored_as_the_buffer_has_them(tmp_path):
    stride = "+buffer.demonstrator.stride=0.5"
    ends = []
    for handled in ("true", "false"):
        config = walked(tmp_path, stride, f"buffer.handle_timeout_termination={handled}")
        buffer = demonstrations_of(config)
        last = np.cumsum(buffer.episodes.table["length"][:4]) - 1
        ends.append(buffer.storage.take(last).terminated.tolist())
    assert ends == [[False, True, True, True], [True] * 4]


def test_a_run_that_is_stopped_while_another_records_stops_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(demonstrations, "POLL_S", 0.01)
    config = walked(tmp_path)
    demonstrated(config)
    (file,) = (tmp_path / "demonstrations").glob("*.npz")
    model = model_of(config)
    task = make_task(config.env)
    demonstrations.attach_demonstration_buffer(config, task, model)

    def stop(_):
        raise InterruptedRunError("stopped", SIGTERM)

    with FileLock(file.with_suffix(".lock")), pytest.raises(InterruptedRunError):
        demonstrations.add_demonstrations(config, task, model, stop)
    assert demonstrations.add_demonstrations(config, task, model, stop).n_successes == 4


def test_the_number_of_recorded_episodes_is_told_after_each_batch(tmp_path, monkeypatch):
    monkeypatch.setattr(ScriptedPolicy, "max_batch_size", 3)
    counts = []
    demonstrated(walked(tmp_path, "buffer.demonstrations=8"), counts.append)
    assert sorted(set(counts)) == [0, 3, 6]
    assert counts == sorted(counts)


def test_a_damaged_file_is_named(tmp_path):
    config = configured(tmp_path)
    demonstrated(config)
    (file,) = (tmp_path / "demonstrations").glob("*.npz")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(ModelError, match=f"{re.escape(str(file))} is damaged; delete it"):
        demonstrated(config)


def test_batches_of_episodes_are_recorded_one_after_the_other(tmp_path, monkeypatch):
    together = demonstrations_of(configured(tmp_path / "together"))
    monkeypatch.setattr(ScriptedPolicy, "max_batch_size", 2)
    apart = demonstrations_of(configured(tmp_path / "apart"))
    assert together.episodes.steps == apart.episodes.steps
    for name in ("obs", "action", "reward"):
        expected = together.storage.data[name][: together.episodes.steps]
        actual = apart.storage.data[name][: together.episodes.steps]
        assert actual.tobytes() == expected.tobytes(), name


def test_a_resumed_run_has_them_from_its_checkpoint(tmp_path):
    whole = tmp_path / "whole"
    pieces = tmp_path / "pieces"
    train(configured(whole))
    shutil.copytree(whole / "demonstrations", pieces / "demonstrations")
    with cut_at(240), pytest.raises(FailedRunError):
        train(configured(pieces))
    shutil.rmtree(pieces / "demonstrations")
    train(configured(pieces))
    assert differences(only_run(whole).path, only_run(pieces).path) == []
    assert not (pieces / "demonstrations").exists()


def test_they_are_part_of_the_run_key():
    keys = set()
    for overrides in (
        (),
        ("buffer.demonstrations=3",),
        ("buffer.demonstrations=4",),
        ("buffer.demonstrations=4", "buffer.demonstration_share=0.5"),
        ("buffer.demonstrations=4", "+buffer.demonstrator.margin_m=0.2"),
    ):
        keys.add(compose("env=parking_bays", *overrides).run_key)
    assert len(keys) == 5


@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (("buffer.demonstrations=-1",), "buffer.demonstrations"),
        (("buffer.demonstrations=3", "buffer.demonstration_share=1.0"), "demonstration_share"),
        (("env=fetch_reach", "buffer.demonstrations=3"), "drives in parking tasks only"),
        (
            ("buffer.demonstration_share=0.5",),
            r"^buffer\.demonstration_share has no effect without demonstrations; leave it out, or "
            r"set buffer\.demonstrations=N$",
        ),
        (("+buffer.demonstrator.margin_m=0.2",), r"^buffer\.demonstrator has no effect without"),
        (
            ("buffer._target_=support.user_policies.OwnSample", "buffer.demonstrations=3"),
            r"buffer.demonstrations=3 needs parking_exp.buffers.HerBuffer, or a subclass that",
        ),
        (
            ("buffer.demonstrations=3", "+buffer.demonstrator.margn_m=0.2"),
            "buffer.demonstrator.margn_m: there is no such key; did you mean 'margin_m'",
        ),
        (
            (
                "buffer.demonstrations=3",
                "buffer.demonstrator._target_=parking_exp.buffers.HerBuffer",
            ),
            "buffer.demonstrator._target_=parking_exp.buffers.HerBuffer is not a subclass of",
        ),
    ],
)
def test_what_can_not_demonstrate_is_refused(overrides, sentence):
    with pytest.raises(ConfigError, match=sentence):
        compose(*overrides)


def test_a_buffer_of_the_library_has_none():
    with pytest.raises(ConfigError, match=r"buffer.demonstrations=3 needs parking_exp.*HerBuffer"):
        compose(
            "buffer=her_future",
            "~buffer.relabel_collision",
            "~buffer.relabel_terminated",
            "~buffer.goal_velocity",
            "buffer._target_=stable_baselines3.HerReplayBuffer",
            "buffer.demonstrations=3",
        )
