"""Configs become models, and models learn."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import CombinedExtractor
from stable_baselines3.common.vec_env import DummyVecEnv
from support.reach import Reach
from support.runs import make_config, options

from parking_exp.algorithms.build import build_model
from parking_exp.buffers import HerBuffer
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import ConfigError

SMALL = ("experiment=smoke", "tracking.mlflow=false")


def test_what_needs_parkings_reward_is_refused_for_another_env():
    with pytest.raises(ConfigError, match="relabelling otherwise than Stable-Baselines3 needs to know the reward"):
        build_model(make_config(*SMALL, "buffer.relabel_collision=keep"), DummyVecEnv([Reach, Reach]), seed=0)


@pytest.mark.parametrize("buffer", options("buffer"))
def test_every_buffer_binds_to_its_constructor(buffer):
    config = make_config(*SMALL, f"buffer={buffer}", "algorithm.learning_starts=40")
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    made = model.replay_buffer
    assert type(made) is HerBuffer
    assert (made.reward.collision, made.reward.threshold) == (-5, -0.1)
    if buffer == "replay":
        assert (made.goal_selection_strategy, made.n_sampled_goal) == (None, 0)
    else:
        assert made.goal_selection_strategy == buffer.removeprefix("her_")
        for name in ("n_sampled_goal", "relabel_collision", "relabel_terminated", "goal_velocity"):
            assert getattr(made, name) == config.buffer.arguments[name]


def test_every_argument_arrives():
    config = make_config(
        *SMALL, "algorithm=td3", "algorithm.policy_delay=3", "algorithm.target_policy_noise=0.3", "algorithm.gamma=0.9",
        "algorithm.tau=0.02", "algorithm.batch_size=33", "algorithm.net_arch=[7,5]", "algorithm.features=raw",
        "algorithm.action_noise.sigma=[0.2,0.3]", "+algorithm.policy_kwargs.n_critics=3", "buffer.buffer_size=640",
    )  # fmt: skip
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=5)
    assert (model.policy_delay, model.target_policy_noise, model.gamma, model.tau) == (3, 0.3, 0.9, 0.02)
    assert (model.batch_size, model.buffer_size, model.seed) == (33, 640, 5)
    assert model.policy_kwargs["net_arch"] == [7, 5]
    assert len(model.critic.q_networks) == 3
    assert list(model.action_noise.base_noise._sigma) == [0.2, 0.3]


def test_a_learning_rate_schedule_is_a_target_node():
    schedule = "{_target_: stable_baselines3.common.utils.LinearSchedule, start: 1e-2, end: 1e-3, end_fraction: 1.0}"
    config = make_config(*SMALL, f"algorithm.learning_rate={schedule}")
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    assert [model.lr_schedule(progress) for progress in (1.0, 0.5, 0.0)] == pytest.approx([1e-2, 5.5e-3, 1e-3])


@pytest.mark.parametrize("algorithm", options("algorithm"))
@pytest.mark.parametrize(
    "written",
    [
        "{name}",
        "{{_target_:hydra.utils.get_class,path:{name}}}",
        "{{_target_:{name},_partial_:true}}",
        "{{_target_:{name}}}",
    ],
)
def test_classes_among_the_policys_arguments_are_dotted_paths_or_targets(algorithm, written):
    classes = {"activation_fn": "torch.nn.Tanh", "optimizer_class": "torch.optim.AdamW"}
    typed = ",".join(f"{key}:{written.format(name=name)}" for key, name in classes.items())
    config = make_config(
        *SMALL, f"algorithm={algorithm}", f"+algorithm.policy_kwargs={{{typed},optimizer_kwargs:{{weight_decay:0.5}}}}"
    )
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    model.set_logger(Logger(None, []))
    model.learn(60)
    assert model._n_updates > 0
    assert {type(module) for module in model.actor.modules()} & {torch.nn.Tanh, torch.nn.ReLU} == {torch.nn.Tanh}
    for network in (model.actor, model.critic):
        assert type(network.optimizer) is torch.optim.AdamW
        assert network.optimizer.param_groups[0]["weight_decay"] == 0.5


def test_arguments_of_a_class_are_given_to_it():
    activation = "{_target_:torch.nn.LeakyReLU,negative_slope:0.3}"
    config = make_config(*SMALL, f"+algorithm.policy_kwargs.activation_fn={activation}")
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    slopes = {module.negative_slope for module in model.actor.modules() if isinstance(module, torch.nn.LeakyReLU)}
    assert slopes == {0.3}


def test_another_features_extractor_takes_the_place_of_ours():
    extractor = "stable_baselines3.common.torch_layers.CombinedExtractor"
    kwargs = f"{{features_extractor_class:{extractor},features_extractor_kwargs:{{cnn_output_dim:32}}}}"
    config = make_config(*SMALL, "algorithm.features=raw", f"+algorithm.policy_kwargs={kwargs}")
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed=0)
    assert type(model.actor.features_extractor) is CombinedExtractor
    assert model.policy_kwargs["features_extractor_kwargs"] == {"cnn_output_dim": 32}


def test_what_the_library_refuses_is_a_config_error():
    """Here what our own check of the config would have refused before."""
    config = make_config(*SMALL)
    algorithm = config.algorithm.model_copy(update={"policy_kwargs": {"optimizer_kwargs": {"betas": [2, 2]}}})
    config = config.model_copy(update={"algorithm": algorithm})
    with pytest.raises(ConfigError, match=r"parking_exp.algorithms.SAC refuses its arguments: Invalid beta"):
        build_model(config, make_training_envs(config.env, config.n_envs), seed=0)


@pytest.mark.slow
def test_a_model_is_made_saved_and_trained_without_torchs_compiler():
    """Importing it takes a second, and every run would pay for it."""
    code = """
import sys, tempfile
from pathlib import Path
from support.runs import make_config
from parking_exp.algorithms.build import build_model
from parking_exp.envs.training_envs import make_training_envs
config = make_config("experiment=smoke")
model = build_model(config, make_training_envs(config.env, 2), seed=0).learn(100)
model.save(Path(tempfile.mkdtemp()) / "model.zip")
import parking_exp.training.train_run
print(model._n_updates > 0, sorted({"torch._dynamo", "scipy.stats"} & set(sys.modules)))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1]
    )
    assert done.stdout == "True []\n"


OWN_POLICY = """
from stable_baselines3 import SAC
from stable_baselines3.sac.policies import MultiInputPolicy

class {name}Policy(MultiInputPolicy):
    def __init__(self, observation_space, action_space, lr_schedule, net_arch=None, use_sde=False{more}):
        super().__init__(observation_space, action_space, lr_schedule, net_arch=net_arch, use_sde=use_sde)

class {name}(SAC):
    policy_aliases = {{"MultiInputPolicy": {name}Policy}}
"""


@pytest.mark.parametrize(("name", "more", "when"), [("Strict", "", "composed"), ("Open", ", **ignored", "built")])
def test_features_that_a_policy_would_ignore_are_refused_before_training(name, more, when, tmp_path, monkeypatch):
    (tmp_path / f"own_{when}.py").write_text(OWN_POLICY.format(name=name, more=more))
    monkeypatch.syspath_prepend(tmp_path)
    target = f"algorithm._target_=own_{when}.{name}"
    fine = "algorithm.features=ego_fine"
    message = rf"^algorithm.features=ego_fine: the policy of own_{when}.{name} .* set algorithm.features=raw$"
    if when == "composed":
        with pytest.raises(ConfigError, match=message):
            make_config("experiment=smoke", target, fine)
    else:
        config = make_config("experiment=smoke", target, fine)
        with pytest.raises(ConfigError, match=message):
            build_model(config, make_training_envs(config.env, 1), seed=0, for_training=False)
    raw = make_config("experiment=smoke", target, "algorithm.features=raw")
    assert build_model(raw, make_training_envs(raw.env, 1), seed=0, for_training=False)
