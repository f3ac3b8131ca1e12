"""One contract for all algorithms: saved and loaded, checkpointed and restored, to the last bit."""

import numpy as np
import pytest
from support.models import make_model, model_of
from support.run_equality import exact, parameters
from support.runs import options

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.algorithms.policy_ema import PolicyEMA
from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.training import checkpoints, rollout_state

SMOKE = ("experiment=smoke", "algorithm.learning_starts=40", "tracking.mlflow=false")
USER = "algorithm._target_=support.user_algorithms"
TRAINED = [option for option in options("algorithm") if option != "planner"]
ALGORITHMS = {option: (f"algorithm={option}",) for option in TRAINED} | {
    "Stable-Baselines3's sac": ("algorithm=sac", "algorithm._target_=stable_baselines3.SAC"),
    "Stable-Baselines3's td3": ("algorithm=td3", "algorithm._target_=stable_baselines3.TD3"),
    "Stable-Baselines3's ddpg": ("algorithm=ddpg", "algorithm._target_=stable_baselines3.DDPG"),
    "sac with gSDE": ("algorithm=sac", "algorithm.use_sde=true"),
    "sac with a fixed entropy coefficient": ("algorithm=sac", "algorithm.ent_coef=0.1"),
    "sac from raw observations": ("algorithm=sac", "algorithm.features=raw"),
    "a user's with an extra network": (f"{USER}.SavesExtraNetwork",),
}


def state(model, directory):
    """All tensors that the model's file has, and its actions on random observations, as bytes."""
    rng = np.random.default_rng(0)
    observations = {
        name: rng.standard_normal((32, *box.shape)) for name, box in model.observation_space.items()
    }
    model.save(directory / "state.zip")
    return parameters(directory / "state.zip") | {
        "actions": exact(GreedyPolicy(model)(observations))
    }


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_restored_from_a_checkpoint_its_next_updates_are_the_same(algorithm, tmp_path, monkeypatch):
    """Parameters, target networks, optimizers, coefficients and actions. Only the filled part of
    the buffer is saved, and nothing is unpickled.
    """
    config, best = compose(*SMOKE, *ALGORITHMS[algorithm]), tmp_path / "best.zip"
    model, other = model_of(config).learn(60), model_of(config, seed=1)
    assert model._n_updates > 0
    average = PolicyEMA(model, None)
    progress = checkpoints.SavedProgress(step=60)
    folder = checkpoints.save(tmp_path, model, average, progress, best, keep_last=1)
    saved = state(model, tmp_path)
    model.train(2, model.batch_size)
    updated = state(model, tmp_path)
    assert (folder / checkpoints.BUFFER).stat().st_size < 60 * 500
    for name in ("pickle.load", "pickle.loads", "cloudpickle.load", "cloudpickle.loads"):
        monkeypatch.setattr(name, lambda *_, **__: pytest.fail("unpickled"))
    rollout_state.set_state(other, checkpoints.restore(folder, other, average, best))
    other.train(2, other.batch_size)
    assert updated != saved
    assert state(other, tmp_path) == updated


@pytest.mark.parametrize(
    ("name", "lost"),
    [
        ("ForgetsExtraNetwork", "curiosity"),
        ("SavesNothing", "policy, actor, critic, critic_target"),
    ],
)
def test_a_class_whose_files_would_lose_weights_is_refused(name, lost):
    sentence = rf"^{USER}\.{name}: .*{lost}; name them in _get_torch_save_params\(\)$"
    with pytest.raises(ConfigError, match=sentence):
        make_model(*SMOKE, f"{USER}.{name}")
