"""The fast update computes what Stable-Baselines3 does, from the same batches and noise."""

import copy
import itertools

import numpy as np
import pytest
import stable_baselines3 as sb3
import torch
from stable_baselines3 import HerReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.type_aliases import DictReplayBufferSamples
from support import models
from support.marks import slow_but

from parking_exp import algorithms
from parking_exp.algorithms.fast.fast_training import is_supported
from parking_exp.algorithms.fast.minibatches import sample_minibatches
from parking_exp.buffers import HerBuffer
from parking_exp.config.compose import compose
from parking_exp.tasks.parking.reward import ParkingReward
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs

REWARD = ParkingReward(compose().env)
ALGORITHMS = ("SAC", "TD3", "DDPG")


def make_model(name, *overrides, module=algorithms, seed=0):
    package = "parking_exp.algorithms" if module is algorithms else "stable_baselines3"
    target = f"algorithm._target_={package}.{name}"
    few = (
        "n_envs=8",
        "updates_per_step=1",
        "algorithm.learning_starts=1000",
        "algorithm.batch_size=64",
    )
    return models.make_model(f"algorithm={name.lower()}", target, *few, *overrides, seed=seed)


def pair(name, *overrides, seed=0):
    """Stable-Baselines3's model and ours, with the same weights."""
    theirs, ours = (
        make_model(name, *overrides, module=module, seed=seed) for module in (sb3, algorithms)
    )
    ours.set_parameters(theirs.get_parameters())
    return theirs, ours


def batches(number, batch_size, seed):
    """Batches with observations of parking's size, some ends of episodes, and negative rewards."""
    generator = torch.Generator().manual_seed(seed)

    def observation():
        keys = ("observation", "achieved_goal", "desired_goal")
        return {key: torch.randn(batch_size, 6, generator=generator) for key in keys}

    return [
        DictReplayBufferSamples(
            observations=observation(),
            actions=torch.rand(batch_size, 2, generator=generator) * 2 - 1,
            next_observations=observation(),
            dones=(torch.rand(batch_size, 1, generator=generator) < 0.1).float(),
            rewards=-torch.rand(batch_size, 1, generator=generator),
        )
        for _ in range(number)
    ]


def joined(parts):
    """Several batches as one, from which they are dealt out in turn."""
    if parts[0] is None:
        return None
    if isinstance(parts[0], dict):
        return {key: joined([part[key] for part in parts]) for key in parts[0]}
    return torch.stack(parts, 1).flatten(0, 1)


def feed(model, samples):
    """Let a model's buffer return these batches, one after the other."""
    iterator = iter(samples)

    def sample(size, env):
        parts = itertools.islice(iterator, size // len(samples[0].rewards))
        return DictReplayBufferSamples(*map(joined, zip(*parts, strict=True)))

    model.replay_buffer.sample = sample


def furthest(ours, theirs):
    """Largest difference between two models' parameters, targets included."""
    pairs = zip(ours.policy.parameters(), theirs.policy.parameters(), strict=True)
    return max((our - their).abs().max().item() for our, their in pairs)


def update(model, samples, calls=100, seed=0):
    feed(model, samples)
    torch.manual_seed(seed)
    for _ in range(calls):
        model.train(gradient_steps=len(samples) // calls, batch_size=len(samples[0].rewards))


@pytest.mark.parametrize(
    "features", slow_but(["ego_mirrored", "raw"], ["ego_mirrored", "ego_fine", "ego", "raw"])
)
@pytest.mark.parametrize("seed", slow_but([0], range(4)))
@pytest.mark.parametrize("name", ALGORITHMS)
def test_100_updates_give_the_parameters_of_stable_baselines3(name, seed, features):
    theirs, ours = pair(name, f"algorithm.features={features}", seed=seed)
    samples = batches(100, 256, seed)
    for model in (theirs, ours):
        update(model, samples)
    assert furthest(ours, theirs) < 1e-5
    assert ours._n_updates == theirs._n_updates == 100
    if name == "SAC":
        assert ours.log_ent_coef.item() == pytest.approx(theirs.log_ent_coef.item(), abs=1e-5)


OPTIONS = [
    ("SAC", "algorithm.ent_coef=0.2"),
    ("SAC", "algorithm.target_update_interval=2"),
    ("SAC", "algorithm.net_arch=[256,256,256]"),
    ("SAC", "+algorithm.policy_kwargs.n_critics=3"),
    ("TD3", "algorithm.policy_delay=3"),
    ("TD3", "algorithm.net_arch=[32]"),
    ("DDPG", "algorithm.batch_size=50"),
]


@pytest.mark.parametrize("option", slow_but(OPTIONS[3:5], OPTIONS), ids="-".join)
def test_options_change_both_alike(option):
    name, override = option
    theirs, ours = pair(name, override)
    assert is_supported(ours)
    samples = batches(100, theirs.batch_size, 0)
    for model in (theirs, ours):
        update(model, samples, calls=25)  # four updates a call
    assert furthest(ours, theirs) < 1e-5


@pytest.mark.parametrize("name", ALGORITHMS)
def test_what_is_logged_is_what_stable_baselines3_logs(name):
    theirs, ours = pair(name)
    samples = batches(6, 64, 0)
    for model in (theirs, ours):
        update(model, samples, calls=1)
    logged = theirs.logger.name_to_value
    assert ours.logger.name_to_value == {
        key: pytest.approx(value, abs=1e-5) for key, value in logged.items()
    }


def test_weights_that_are_loaded_or_moved_between_updates_are_used():
    theirs, ours = pair("SAC", seed=0)
    donor = make_model("SAC", seed=1)
    samples = batches(30, 64, 0)
    update(donor, samples[:10], calls=10)
    for model in (theirs, ours):
        update(model, samples[:10], calls=10)
        model.set_parameters(
            copy.deepcopy(donor.get_parameters())
        )  # torch would take the state itself, not a copy
        model.actor.mu.weight.data = model.actor.mu.weight.data.clone()
        update(model, samples[10:], calls=20)
    assert furthest(ours, theirs) < 1e-5


class OtherPolicy(sb3.sac.MultiInputPolicy):
    """A policy that may compute something else with the same networks."""


class OtherExtractor(CombinedExtractor):
    """Features that may do anything."""


@pytest.mark.parametrize(
    "arguments",
    [
        {"replay_buffer_class": HerReplayBuffer, "replay_buffer_kwargs": {}},
        {"policy": OtherPolicy},
        {"use_sde": True},
        {"policy_kwargs": {"features_extractor_class": OtherExtractor}},
        {"policy_kwargs": {"activation_fn": torch.nn.Tanh}},
        {"policy_kwargs": {"optimizer_class": torch.optim.AdamW}},
        {"policy_kwargs": {"optimizer_kwargs": {"amsgrad": True}}},
        {"policy_kwargs": {"net_arch": []}},
    ],
)
def test_unsupported_models_are_trained_by_stable_baselines3(arguments):
    env = make_training_envs(make_task(compose().env), 2)
    shared = {"policy": "MultiInputPolicy", "env": env, "seed": 0, "buffer_size": 10}
    her = {"replay_buffer_class": HerBuffer, "replay_buffer_kwargs": {"reward": REWARD}}
    assert is_supported(algorithms.SAC(**shared, **her))
    arguments = shared | her | arguments
    theirs, ours = sb3.SAC(**arguments), algorithms.SAC(**arguments)
    assert not is_supported(ours)
    samples = batches(5, 64, 0)
    for model in (theirs, ours):
        model.set_logger(Logger(None, []))
        update(model, samples, calls=5)
    assert furthest(ours, theirs) == 0


def test_minibatches_sampled_together_have_each_their_share_of_virtual_goals():
    """Of 8 x 64 transitions int(0.8 x 512) = 409 are virtual, 51 or 52 in each minibatch."""
    model = make_model(
        "SAC",
        "buffer.relabel_collision=keep",
        "buffer.relabel_terminated=goal",
        "buffer.n_sampled_goal=4",
    )
    model.learning_starts = 4000
    model.learn(4000)
    real = {tuple(goal) for goal in np.float32(model.replay_buffer.episodes.table["goal"]).tolist()}
    model.actor.extract_features = lambda observation, extractor: observation[
        "desired_goal"
    ].float()
    virtual = []
    for minibatch in sample_minibatches(model, 8, 64):
        assert minibatch.features.shape == (128, 6)
        assert minibatch.actions.shape == (64, 2)
        assert torch.equal(minibatch.features[:64], minibatch.features[64:])
        virtual.append(sum(tuple(goal) not in real for goal in minibatch.features[:64].tolist()))
    assert sum(virtual) == 409
    assert set(virtual) == {51, 52}
    # Very many are sampled in parts.
    assert [len(minibatch.actions) for minibatch in sample_minibatches(model, 130, 16)] == [
        16
    ] * 130
