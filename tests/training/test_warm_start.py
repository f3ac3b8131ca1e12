"""A run starts from the networks and the replay buffer of another (`init`, `init_buffer`)."""

import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from support.interruptions import cut_at
from support.models import model_of
from support.run_equality import differences, parameters
from support.runs import only_run, refusal, store
from torch.nn.utils import parameters_to_vector

from parking_exp.config.compose import compose
from parking_exp.errors import FailedRunError, ModelError, RunNotFoundError
from parking_exp.evaluation.init_sources import find_source, pin_source
from parking_exp.runs.directory import RunDirectory
from parking_exp.runs.foreign_files import sha256
from parking_exp.sweeps.single_run import train
from parking_exp.training import warm_start
from parking_exp.training.checkpoints import latest

SMOKE = (
    "experiment=smoke",
    "total_timesteps=160",
    "evaluation.every_n_steps=60",
    "evaluation.n_scenes=1",
    "evaluation.final_n_scenes=2",
    "evaluation.video_episodes=0",
    "checkpoint.every_n_steps=50",
    "tracking.progress_bar=false",
)
WITHOUT_STORE = "tracking.mlflow=false"


def configured(output_dir, *overrides):
    return compose(*SMOKE, *overrides, f"output_dir={output_dir}")


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """An output directory with a finished run of SAC."""
    output_dir = tmp_path_factory.mktemp("trained")
    train(configured(output_dir, WITHOUT_STORE))
    return output_dir


@pytest.fixture
def source(trained, tmp_path):
    """The run in a copy of that directory."""
    output_dir = tmp_path / "outputs"
    shutil.copytree(trained, output_dir)
    return only_run(output_dir)


def from_source(source, *overrides):
    return pin_source(configured(source.output_dir, f"init='{source.path}'", *overrides))


def test_networks_and_entropy_coefficient_are_the_sources_and_optimizers_are_new(source):
    config = from_source(source)
    model = model_of(config)
    file = source.models / "final.zip"
    assert warm_start.load_source(config, model).weights == file

    stored = parameters(file)
    networks = model.policy.state_dict()
    assert len(networks) == sum(name.startswith("policy.pth/") for name in stored) > 0
    for name, weight in networks.items():
        assert weight.numpy().tobytes() == stored[f"policy.pth/{name}"][2], name
    coefficient = model.log_ent_coef.detach().numpy()
    assert coefficient.tobytes() == stored["pytorch_variables.pth/log_ent_coef"][2]
    assert model.actor.optimizer.state_dict()["state"] == {}
    assert model.replay_buffer.size() == 0


def test_keys_of_the_optimizer_may_differ(source):
    config = from_source(source, "++algorithm.policy_kwargs.optimizer_kwargs.eps=1e-6")
    warm_start.check_sources([config])
    model = model_of(config)
    warm_start.load_source(config, model)
    assert model.actor.optimizer.param_groups[0]["eps"] == 1e-6


def test_a_fixed_entropy_coefficient_stays(source):
    config = from_source(source, "algorithm.ent_coef=0.3")
    model = model_of(config)
    warm_start.load_source(config, model)
    assert model.ent_coef_tensor.item() == pytest.approx(0.3)


def test_the_replay_buffer_has_the_sources_transitions_and_no_episode_under_way(source):
    config = from_source(source, "init_buffer=true", "algorithm.learning_starts=0")
    model = model_of(config)
    own = model.replay_buffer.rng.bit_generator.state
    warm_start.load_source(config, model)

    buffer = model.replay_buffer
    with np.load(latest(source.checkpoints) / "replay_buffer.npz") as stored:
        assert buffer.storage.data[:80].tobytes() == stored["rows"].tobytes()
        assert (stored["current"] >= 0).all()  # the source ended within episodes
    assert buffer.pos == 80  # of 2 envs each
    assert (buffer.episodes.head == 80).all()
    assert (buffer.episodes.current == -1).all()
    assert buffer.rng.bit_generator.state == own


@pytest.mark.parametrize(
    ("agent", "env", "units", "observation", "has_critics"),
    [
        ("crowded", "parking_stop_crowded", 128, ["vehicles_count=4"], False),
        ("parked", "parking_stop", 64, ["vehicles_count=0"], True),
        ("parallel", "parking_parallel", 128, ["vehicles_count=4"], True),
        ("lots", "parking_lots", 256, ["rays=16", "rays_range_m=20"], True),
    ],
)
def test_networks_of_a_pretrained_agent_are_their_own_targets(
    agent, env, units, observation, has_critics
):
    config = compose(
        f"init=pretrained/{agent}",
        f"env={env}",
        *[f"env.observation.{setting}" for setting in observation],
        "algorithm=td3",
        f"algorithm.net_arch=[{units},{units}]",
    )
    model = model_of(config.model_copy(update={"n_envs": 1}))
    new_critics = parameters_to_vector(model.critic.parameters())
    warm_start.load_source(config, model)
    for name, weight in model.actor_target.state_dict().items():
        assert torch.equal(weight, model.actor.state_dict()[name]), name
    for name, weight in model.critic_target.state_dict().items():
        assert torch.equal(weight, model.critic.state_dict()[name]), name
    critics = parameters_to_vector(model.critic.parameters())
    assert torch.equal(critics, new_critics) != has_critics


def test_a_resumed_run_equals_an_uninterrupted_one_and_does_without_its_source(source, tmp_path):
    overrides = (
        f"init='{source.path}'",
        "init_buffer=true",
        "algorithm.learning_starts=0",
        "experiment_name=finetuned",
    )
    copied = tmp_path / "copy" / "outputs"
    shutil.copytree(source.output_dir, copied)
    whole = RunDirectory(Path(train(configured(source.output_dir, *overrides)).run_dir))

    copied_source = only_run(copied)
    overrides = (f"init='{copied_source.path}'", *overrides[1:])
    with cut_at(131), pytest.raises(FailedRunError):
        train(configured(copied, *overrides, WITHOUT_STORE))
    shutil.rmtree(copied_source.path)
    resumed = train(configured(copied, *overrides, WITHOUT_STORE))
    assert differences(whole.path, Path(resumed.run_dir)) == []

    run = store(source.output_dir).get_run(whole.run_id)
    assert run.data.params["init"] == str(source.path.relative_to(source.output_dir))
    assert run.data.tags["init_sha256"] == sha256(source.models / "final.zip")


LAYER = (
    r"^init=.*seed=0: .*final\.zip does not fit: its layer actor\.latent_pi\.0\.weight "
    "has 19 inputs and 16 units, and the model's has 20 inputs and 16 units; observations, actions "
    "and networks have to be as large as in its training$"
)
NO_SEED = r"^init=.*: this cell has no run with seed 2; it has seed=0 and seed=1$"
MISFITS = {
    r"its algorithm.net_arch is \[16, 16\], and this run's is \[8\]$": ["algorithm.net_arch=[8]"],
    r"its algorithm.features is ego_mirrored, and this run's is ego$": ["algorithm.features=ego"],
    r"its algorithm._target_ is .*\.SAC, and this run's is .*\.TD3$": ["algorithm=td3"],
    r"its algorithm\.policy_kwargs\.n_critics is null, and this run's is 3$": [
        "+algorithm.policy_kwargs.n_critics=3"
    ],
    LAYER: ["env=parking_stop"],
    r"init=pretrained/parked has no checkpoint, and so no replay buffer$": [
        *("init=pretrained/parked", "env=parking_stop", "env.observation.vehicles_count=0"),
        *("algorithm=td3", "algorithm.net_arch=[64,64]", "init_buffer=true"),
    ],
    r"its n_envs is 2, and this run's is 1$": ["init_buffer=true", "n_envs=1"],
    r"its env.collision_reward is -5, and this run's is -7$": [
        "init_buffer=true",
        "env.collision_reward=-7",
    ],
    r"its env.standing_reward is 0, and this run's is -0.3$": [
        "init_buffer=true",
        "env=parking_parallel",
        "env.reward_weights=[1,0.3,0,0,0.02,0.02]",
        "env.standing_reward=-0.3",
    ],
}


@pytest.mark.parametrize(("message", "overrides"), MISFITS.items())
def test_what_does_not_fit_is_one_sentence_and_nothing_is_written(source, message, overrides):
    files = sorted(source.output_dir.rglob("*"))
    lines = [*SMOKE, f"output_dir={source.output_dir}", f"init={source.path}"]
    assert re.search(message, refusal("train", *lines, *overrides))
    assert sorted(source.output_dir.rglob("*")) == files


def test_latest_is_what_it_was_when_the_config_was_planned(source):
    config = configured(source.output_dir, "init=latest", "experiment_name=finetuned")
    named = pin_source(config)
    assert named.init == str(source.path.relative_to(source.output_dir))
    assert named.run_key == from_source(source, "experiment_name=finetuned").run_key
    planned = RunDirectory(named.run_dir)
    planned.write_config(named)
    planned.update_status(status="done")

    newer = source.path.with_name("seed=1")
    shutil.copytree(source.path, newer)
    final = newer / "models" / "final.zip"
    os.utime(final, (final.stat().st_mtime + 10,) * 2)
    assert pin_source(config) == named
    other = pin_source(configured(source.output_dir, "init=latest", "algorithm.gamma=0.9"))
    assert other.init == str(newer.relative_to(source.output_dir))


def test_of_a_cell_each_seed_starts_from_the_run_with_its_seed(source):
    shutil.copytree(source.path, source.path.with_name("seed=1"))
    config = configured(source.output_dir, f"init='{source.path.parent}'")
    for seed in (0, 1):
        of_seed = pin_source(config).model_copy(update={"seed": seed})
        assert of_seed.cell_key == pin_source(config).cell_key
        assert find_source(of_seed).folder == source.path.with_name(f"seed={seed}")
    with pytest.raises(RunNotFoundError, match=NO_SEED):
        find_source(pin_source(config).model_copy(update={"seed": 2}))


def test_transitions_with_other_fields_are_refused(source):
    config = from_source(source, "init_buffer=true", "algorithm.learning_starts=0")
    model = model_of(config)
    with np.load(latest(source.checkpoints) / "replay_buffer.npz") as stored:
        state = dict(stored)
    state["rows"] = state["rows"][["obs", "next_obs"]]
    with pytest.raises(ModelError, match=r"^the stored replay buffer has transitions with other "):
        model.replay_buffer.set_transitions(state)
