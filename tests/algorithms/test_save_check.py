"""An algorithm whose models can't be saved and restored exactly does not train, and is not evaluated."""

import shutil

import pytest
from omegaconf import OmegaConf
from stable_baselines3.common.logger import Logger
from support.runs import make_config, run_script
from support.sweep_processes import MISBEHAVING, statuses, sweep

from parking_exp.algorithms import save_check
from parking_exp.algorithms.build import build_model
from parking_exp.algorithms.save_check import PROVEN, check_saving, difference
from parking_exp.config.compose import composed
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import ConfigError
from parking_exp.evaluation.stored_run import evaluate_run
from parking_exp.training.run import train

SMOKE = ("experiment=smoke", "algorithm.learning_starts=40", "tracking.mlflow=false")
KINDS = {
    "lean.sac.SAC": ("algorithm=sac",),
    "lean.td3.TD3": ("algorithm=td3",),
    "lean.td3.DDPG": ("algorithm=ddpg",),
    "crossq.CrossQ": ("algorithm=crossq",),
    "sac.sac.SAC": ("algorithm=sac", "algorithm._target_=stable_baselines3.SAC"),
    "td3.td3.TD3": ("algorithm=td3", "algorithm._target_=stable_baselines3.TD3"),
    "ddpg.ddpg.DDPG": ("algorithm=ddpg", "algorithm._target_=stable_baselines3.DDPG"),
    "tqc.tqc.TQC": ("algorithm=tqc",),
    "lean.sac.SAC with gSDE": ("algorithm=sac", "algorithm.use_sde=true"),
    "lean.sac.SAC with a fixed coefficient": ("algorithm=sac", "algorithm.ent_coef=0.1"),
    "tqc.tqc.TQC with a fixed coefficient": ("algorithm=tqc", "algorithm.ent_coef=0.1"),
    "lean.sac.SAC from raw observations": ("algorithm=sac", "algorithm.features=raw"),
}


def built(config, seed, steps=0):
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed)
    model.set_logger(Logger(None, []))
    if steps:
        model.learn(steps)
    return model


@pytest.mark.parametrize("kind", KINDS)
def test_a_trained_model_of_a_proven_class_is_restored_to_the_last_bit(kind):
    """Parameters, target networks, optimizers, coefficients and actions: what is not checked again when it is used."""
    config = make_config(*SMOKE, *KINDS[kind])
    model, other = built(config, seed=0, steps=60), built(config, seed=1)
    assert model._n_updates > 0
    name = f"{type(model).__module__}.{type(model).__qualname__}"
    assert name.endswith(f".{kind.split(' ')[0]}")
    assert name in PROVEN
    assert difference(model, other, model.env) is None


def test_all_proven_classes_are_proven():
    kinds = {kind.split(" ")[0] for kind in KINDS}
    assert {name for name in PROVEN if name.partition(".")[2] in kinds} == PROVEN
    assert len(kinds) == len(PROVEN)


@pytest.mark.parametrize(
    ("kind", "problem"),
    [
        ("SavesNothing", "log_ent_coef, ent_coef_optimizer, policy.actor.latent_pi.0.weight, policy.actor.latent_pi.0.bias, ... would be lost"),
        ("SavesNoOptimizer", "policy.critic.optimizer would be lost; its _get_torch_save_params() must name what holds them"),
        ("SavesNoTensor", "scales.actions.0 would be lost"),
        ("SavesNoModule", "curiosity.members.0.weight, curiosity.members.0.bias, curiosity.members.1.weight, curiosity.members.1.bias, ... would be lost"),
        ("NamesNothing", "support.failing_algorithms.NamesNothing has no actr, which its _get_torch_save_params() names"),
        ("CannotBeSaved", "save() fails with TypeError: cannot pickle '_thread.lock' object"),
        ("ActsFromElsewhere", "the deterministic action changed on the way"),
        ("HasNoTorch", "its file does not fit misbehaving.HasNoTorch as its config.yaml describes it (it has no weights that could be loaded)"),
    ],
)  # fmt: skip
def test_a_class_that_is_not_restored_exactly_is_refused_before_anything_is_made(tmp_path, kind, problem):
    target = f"support.failing_algorithms.{kind}"
    with pytest.raises(ConfigError) as refusal:
        train(make_config(*SMOKE, f"output_dir={tmp_path}", f"algorithm._target_={target}"))
    words = f"algorithm._target_={target} can't be saved and restored exactly, and would be evaluated and resumed with other weights: {problem}"
    assert str(refusal.value).startswith(words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["SavesModules", "Lingers"])
def test_another_class_that_is_restored_exactly_is_let_through(kind):
    check_saving(make_config(*SMOKE, f"algorithm._target_=misbehaving.{kind}"))


def test_a_class_that_is_the_same_for_every_seed_shows_nothing(monkeypatch):
    """Its weights might as well not have been loaded."""
    build = save_check.build_model
    monkeypatch.setattr(save_check, "build_model", lambda config, env, seed, **rest: build(config, env, 1, **rest))
    with pytest.raises(ConfigError, match="models of two seeds are the same from the start"):
        check_saving(make_config(*SMOKE, "algorithm._target_=misbehaving.Lingers"))


def test_the_refusal_is_one_sentence_and_in_a_sweep_the_reason(tmp_path):
    target = "algorithm._target_=misbehaving.SavesNothing"
    done = run_script("train", *SMOKE, f"output_dir={tmp_path / 'one'}", target, env=MISBEHAVING)
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {target} can't be saved and restored exactly")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "one").exists()
    assert sweep(tmp_path, target, "hydra/launcher=basic").returncode == 2
    (status,) = statuses(tmp_path).values()
    assert status["status"] == "failed"
    assert status["error"].startswith(f"{target} can't be saved")


def test_a_run_of_such_a_class_is_not_evaluated(smoke, tmp_path):
    """One that was trained before it was refused."""
    directory = tmp_path / "run"
    (directory / "models").mkdir(parents=True)
    for name in ("config.yaml", "status.json", "models/final.zip"):
        shutil.copyfile(smoke[0].path / name, directory / name)
    config = OmegaConf.load(directory / "config.yaml")
    config.algorithm._target_ = "support.failing_algorithms.SavesNothing"
    OmegaConf.save(config, directory / "config.yaml")
    (request,) = composed("evaluate", [f"run='{directory}'", "episodes=1", "tracking.mlflow=false", "trust=true"])
    with pytest.raises(ConfigError, match=r"algorithm\._target_=misbehaving\.SavesNothing can't be saved and restored"):
        evaluate_run(request)
    assert not (directory / "evaluations").exists()
