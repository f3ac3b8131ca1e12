"""Normalisation has one scale for all goals, and is saved with the policy."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from support.models import make_model

from parking_exp.algorithms.model_files import load_weights
from parking_exp.algorithms.normalization import KINDS, NormalizedExtractor, Normalizer
from parking_exp.training.checkpoints import save_model

SPACE = spaces.Dict({key: spaces.Box(-np.inf, np.inf, (2,), np.float64) for key in KINDS})


def seen():
    rng = np.random.default_rng(0)
    return {key: rng.normal(i, 1 + i, (50, 2)) for i, key in enumerate(KINDS)}


def test_entries_are_scaled_by_mean_and_deviation_and_both_goals_alike():
    normalizer, entries = Normalizer(SPACE), seen()
    for part in (slice(None, 20), slice(20, None)):
        normalizer.update({key: values[part] for key, values in entries.items()})
    goals = np.concatenate([entries["achieved_goal"], entries["desired_goal"]])
    for key, known in (
        ("observation", entries["observation"]),
        ("achieved_goal", goals),
        ("desired_goal", goals),
    ):
        expected = np.clip((entries[key] - known.mean(0)) / known.std(0), -5, 5)
        scaled = normalizer(key, torch.as_tensor(entries[key]))
        assert scaled.dtype == torch.float32
        np.testing.assert_allclose(scaled, expected, rtol=0, atol=1e-5)
    far = torch.full((1, 2), 1e6, dtype=torch.float64)
    assert normalizer("desired_goal", far).tolist() == [[5, 5]]
    assert normalizer("achieved_goal", -far).tolist() == [[-5, -5]]


def test_before_any_update_nothing_is_scaled():
    values = torch.tensor([[0.5, -2.0]], dtype=torch.float64)
    assert Normalizer(SPACE)("observation", values).tolist() == [[0.5, -2.0]]


@pytest.mark.parametrize("algorithm", ["sac", "td3"])
def test_all_networks_share_the_statistics_which_are_saved_with_the_model(algorithm, tmp_path):
    options = [
        "experiment=smoke",
        f"algorithm={algorithm}",
        "algorithm.features=raw",
        "algorithm.normalize=true",
    ]
    model, other = make_model(*options), make_model(*options, seed=1)
    kinds = [type(module) for module in model.policy.modules()]  # each once
    assert kinds.count(NormalizedExtractor) > 1 == kinds.count(Normalizer)
    rng = np.random.default_rng(1)
    observation = {key: rng.normal(3, 2, (20, 6)) for key in KINDS}
    before = model.predict(observation, deterministic=True)[0]
    model.policy.actor.features_extractor.normalizer.update(observation)
    action = model.predict(observation, deterministic=True)[0]
    assert not np.allclose(action, before, atol=1e-3)
    save_model(model, tmp_path / "model.zip")
    load_weights(tmp_path / "model.zip", other)
    np.testing.assert_array_equal(other.predict(observation, deterministic=True)[0], action)
