"""Configs become models."""

import pytest
import torch
from stable_baselines3.common.torch_layers import CombinedExtractor
from support.marks import slow_but
from support.models import make_model
from support.runs import ROOT, options, run_code

from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.torch_settings import torch_settings
from parking_exp.buffers import HerBuffer
from parking_exp.config.compose import compose
from parking_exp.errors import ConfigError
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs

EXTRACTOR = "stable_baselines3.common.torch_layers.CombinedExtractor"
SMALL = ("experiment=smoke", "tracking.mlflow=false")


def built(*overrides, seed=0):
    return make_model(*SMALL, *overrides, seed=seed)


@pytest.mark.parametrize("simulator", slow_but(["vectorized"], ["vectorized", "highway_env"]))
@pytest.mark.parametrize("buffer", options("buffer"))
def test_every_buffer_binds_to_its_constructor(buffer, simulator):
    made = built(
        f"buffer={buffer}", "algorithm.learning_starts=40", f"env.simulator={simulator}"
    ).replay_buffer
    assert type(made) is HerBuffer
    assert (made.reward.failure_penalty, made.reward.threshold) == (-5, -0.1)
    if buffer == "replay":
        assert (made.goal_selection_strategy, made.n_sampled_goal) == (None, 0)
    else:
        arguments = compose(*SMALL, f"buffer={buffer}").buffer.arguments
        assert made.goal_selection_strategy == buffer.removeprefix("her_")
        for name in ("n_sampled_goal", "relabel_collision", "relabel_terminated", "goal_velocity"):
            assert getattr(made, name) == arguments[name]


def test_every_argument_arrives():
    """Also classes, written as dotted paths, and objects, written as `_target_` nodes."""
    schedule = (
        "{_target_: stable_baselines3.common.utils.LinearSchedule, "
        "start: 1e-2, end: 1e-3, end_fraction: 1.0}"
    )
    model = built(
        "algorithm=td3",
        "algorithm.policy_delay=3",
        "algorithm.target_policy_noise=0.3",
        "algorithm.gamma=0.9",
        "algorithm.tau=0.02",
        "algorithm.batch_size=33",
        "algorithm.net_arch=[7,5]",
        "algorithm.features=raw",
        "algorithm.action_noise.sigma=[0.2,0.3]",
        "+algorithm.policy_kwargs.n_critics=3",
        "buffer.buffer_size=640",
        "+algorithm.policy_kwargs.activation_fn={_target_:torch.nn.LeakyReLU,negative_slope:0.3}",
        "+algorithm.policy_kwargs.optimizer_class=torch.optim.AdamW",
        "+algorithm.policy_kwargs.optimizer_kwargs.weight_decay=0.5",
        f"+algorithm.policy_kwargs.features_extractor_class={EXTRACTOR}",
        "+algorithm.policy_kwargs.features_extractor_kwargs.cnn_output_dim=32",
        f"algorithm.learning_rate={schedule}",
        seed=5,
    )
    assert model.actor.mu[1].negative_slope == 0.3
    assert [model.lr_schedule(progress) for progress in (1.0, 0.5, 0.0)] == pytest.approx(
        [1e-2, 5.5e-3, 1e-3]
    )
    assert (model.policy_delay, model.target_policy_noise, model.gamma, model.tau) == (
        3,
        0.3,
        0.9,
        0.02,
    )
    assert (model.batch_size, model.buffer_size, model.seed) == (33, 640, 5)
    assert model.policy_kwargs["net_arch"] == [7, 5]
    assert type(model.actor.features_extractor) is CombinedExtractor
    assert model.policy_kwargs["features_extractor_kwargs"] == {"cnn_output_dim": 32}
    for network in (model.actor, model.critic):
        assert type(network.optimizer) is torch.optim.AdamW
        assert network.optimizer.param_groups[0]["weight_decay"] == 0.5
    assert len(model.critic.q_networks) == 3
    assert list(model.action_noise.base_noise._sigma) == [0.2, 0.3]


def test_what_the_library_refuses_is_a_config_error():
    """Here what our own check of the config would have refused before."""
    config = compose(*SMALL)
    algorithm = config.algorithm.model_copy(
        update={"policy_kwargs": {"optimizer_kwargs": {"betas": [2, 2]}}}
    )
    config = config.model_copy(update={"algorithm": algorithm})
    task = make_task(config.env)
    envs = make_training_envs(task, config.n_envs)
    with pytest.raises(ConfigError, match=r"parking_exp.algorithms.SAC .*Invalid beta"):
        build_model(config, task, envs, seed=0)


def test_a_runs_threads_and_precision_hold_while_it_runs():
    before = torch.get_num_threads(), torch.get_float32_matmul_precision()
    with torch_settings(compose("torch_threads=2", "precision=medium")):
        assert (torch.get_num_threads(), torch.get_float32_matmul_precision()) == (2, "medium")
    assert (torch.get_num_threads(), torch.get_float32_matmul_precision()) == before


@pytest.mark.slow
def test_a_model_is_made_saved_and_trained_without_torchs_compiler():
    """Importing it takes a second, and every run would pay for it."""
    code = """
import sys, tempfile
from pathlib import Path
from parking_exp.algorithms.build_model import build_model
from parking_exp.config.compose import compose
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs
config = compose("experiment=smoke")
task = make_task(config.env)
model = build_model(config, task, make_training_envs(task, 2), seed=0).learn(100)
model.save(Path(tempfile.mkdtemp()) / "model.zip")
print(model._n_updates > 0, "torch._dynamo" in sys.modules)
"""
    assert run_code(code, cwd=ROOT / "tests").stdout == "True False\n"
