"""One contract for all algorithms: accepted or refused by name, saved and loaded, checkpointed and restored, to the last bit."""

import functools
import shutil
from types import SimpleNamespace

import pytest
from hydra.utils import get_class
from omegaconf import OmegaConf
from stable_baselines3.common.logger import Logger
from support import user_algorithms
from support.model_state import model_state
from support.runs import make_config, options
from support.sweep_processes import statuses, sweep

from parking_exp.algorithms.build import build_model
from parking_exp.algorithms.features import EgoFrameExtractor
from parking_exp.algorithms.model_files import PROVEN, class_path, load_weights
from parking_exp.algorithms.save_check import check_saving
from parking_exp.config.compose import composed
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import ConfigError, FailedRunError, ModelError
from parking_exp.evaluation.evaluate_run import evaluate_run
from parking_exp.training import checkpoints, rollout_state
from parking_exp.training.run import train

SMOKE = ("experiment=smoke", "algorithm.learning_starts=40", "tracking.mlflow=false")
USER = "algorithm._target_=support.user_algorithms"
ALGORITHMS = {option: (f"algorithm={option}",) for option in options("algorithm")} | {
    "Stable-Baselines3's sac": ("algorithm=sac", "algorithm._target_=stable_baselines3.SAC"),
    "Stable-Baselines3's td3": ("algorithm=td3", "algorithm._target_=stable_baselines3.TD3"),
    "Stable-Baselines3's ddpg": ("algorithm=ddpg", "algorithm._target_=stable_baselines3.DDPG"),
    "sac with gSDE": ("algorithm=sac", "algorithm.use_sde=true"),
    "sac with a fixed entropy coefficient": ("algorithm=sac", "algorithm.ent_coef=0.1"),
    "tqc with a fixed entropy coefficient": ("algorithm=tqc", "algorithm.ent_coef=0.1"),
    "sac from raw observations": ("algorithm=sac", "algorithm.features=raw"),
    "a user's with an extra network": (f"{USER}.SavesExtraNetwork",),
}


@functools.cache
def configured(algorithm):
    return make_config(*SMOKE, *ALGORITHMS[algorithm])


def built(config, seed):
    model = build_model(config, make_training_envs(config.env, config.n_envs), seed)
    model.set_logger(Logger(None, []))
    return model


def differences(one, other):
    return sorted(name for name in {*one, *other} if name not in one or one[name] != other.get(name))


@pytest.fixture(scope="module", params=ALGORITHMS)
def trained(request, tmp_path_factory):
    """A model that was saved in a checkpoint after its first updates, and then made two more."""
    config, directory = configured(request.param), tmp_path_factory.mktemp("checkpoints")
    model = built(config, seed=0).learn(60)
    assert model._n_updates > 0
    folder = checkpoints.save(directory, model, checkpoints.Progress(step=60), directory / "best.zip", keep_last=1)
    saved = model_state(model)
    model.train(2, model.batch_size)
    return SimpleNamespace(config=config, model=model, folder=folder, saved=saved, updated=model_state(model))


def test_its_config_is_accepted_and_becomes_a_model_of_its_class(trained):
    assert type(trained.model) is get_class(trained.config.algorithm.target)
    has_ego_features = isinstance(trained.model.actor.features_extractor, EgoFrameExtractor)
    assert has_ego_features == (trained.config.algorithm.features != "raw")


def test_loaded_into_another_model_it_has_the_same_weights_and_actions(trained):
    other = built(trained.config, seed=1)
    assert "the deterministic action" in differences(trained.saved, model_state(other))
    load_weights(trained.folder / "model.zip", other)
    assert differences(trained.saved, model_state(other)) == []


def test_restored_from_a_checkpoint_its_next_updates_are_the_same(trained, tmp_path):
    """Parameters, target networks, optimizers, coefficients and actions."""
    other = built(trained.config, seed=1)
    rollout_state.set_state(other, checkpoints.restore(trained.folder, other, tmp_path / "best.zip"))
    assert differences(trained.saved, model_state(other)) == []
    other.train(2, other.batch_size)
    assert differences(trained.saved, trained.updated) != []
    assert differences(trained.updated, model_state(other)) == []


@pytest.mark.parametrize("algorithm", [*options("algorithm"), "a user's with an extra network"])
def test_an_argument_that_it_does_not_take_is_refused_by_name(algorithm):
    with pytest.raises(ConfigError, match=r"^algorithm\.no_such: "):
        make_config(*SMOKE, *ALGORITHMS[algorithm], "+algorithm.no_such=1")


def test_what_is_passed_unchecked_is_proven_here_all_options_among_it():
    proven = {class_path(get_class(configured(algorithm).algorithm.target)) for algorithm in ALGORITHMS}
    assert proven >= PROVEN
    for option in options("algorithm"):
        assert class_path(get_class(configured(option).algorithm.target)) in PROVEN


REFUSED = {
    "SavesNothing": "its _get_torch_save_params() names no weights",
    "ForgetsOptimizer": "policy.critic.optimizer would be lost",
    "ForgetsTensor": "scales.actions.0 would be lost",
    "ForgetsExtraNetwork": "curiosity.members.0.weight, ",
    "NamesMissingAttribute": "support.user_algorithms.NamesMissingAttribute has no actr, which its _get_torch_save_params() names",
    "KeepsWeightsInArrays": "its _get_torch_save_params() names no weights",
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_class_that_is_not_restored_exactly_is_refused_before_anything_is_made(tmp_path, name):
    features = "raw" if name == "KeepsWeightsInArrays" else "ego"
    with pytest.raises(ConfigError) as refusal:
        train(make_config(*SMOKE, f"output_dir={tmp_path}", f"{USER}.{name}", f"algorithm.features={features}"))
    assert str(refusal.value).startswith(f"{USER}.{name} can't be saved and restored exactly: {REFUSED[name]}")
    assert "\n" not in str(refusal.value)
    assert list(tmp_path.iterdir()) == []


def test_weights_that_a_class_makes_while_it_trains_are_refused_before_anything_is_saved_without_them(tmp_path):
    config = make_config(*SMOKE, f"output_dir={tmp_path}", f"{USER}.ForgetsTensorMadeInTrain")
    with pytest.raises(
        FailedRunError, match="ForgetsTensorMadeInTrain can't be saved and restored exactly: running_mean"
    ):
        train(config)
    assert list(tmp_path.rglob("*.zip")) == []


def test_a_user_class_that_is_restored_exactly_passes_the_check():
    config = configured("a user's with an extra network")
    assert class_path(get_class(config.algorithm.target)) not in PROVEN  # it is checked, and not passed by its name
    check_saving(config)


def test_features_that_the_policy_ignores_are_refused_instead_of_vanishing():
    for features in ("ego_fine", "ego_mirrored"):
        with pytest.raises(ConfigError, match=rf"^algorithm.features={features}: the policy of .*IgnoresFeatures"):
            check_saving(make_config(*SMOKE, f"{USER}.IgnoresFeatures", f"algorithm.features={features}"))
    check_saving(make_config(*SMOKE, f"{USER}.IgnoresFeatures", "algorithm.features=raw"))


@pytest.mark.slow
def test_in_a_sweep_the_refusal_is_the_reason_of_the_failure(tmp_path):
    assert sweep(tmp_path, f"{USER}.SavesNothing", "hydra/launcher=basic").returncode == 2
    (status,) = statuses(tmp_path).values()
    assert status["status"] == "failed"
    assert status["error"].startswith(f"{USER}.SavesNothing can't be saved")


def test_a_run_of_a_refused_class_is_not_evaluated(smoke, tmp_path):
    """One that was trained before it was refused."""
    directory = tmp_path / "run"
    (directory / "models").mkdir(parents=True)
    for name in ("config.yaml", "status.json", "models/final.zip"):
        shutil.copyfile(smoke[0].path / name, directory / name)
    config = OmegaConf.load(directory / "config.yaml")
    config.algorithm._target_ = "support.user_algorithms.SavesNothing"
    OmegaConf.save(config, directory / "config.yaml")
    (request,) = composed("evaluate", [f"run='{directory}'", "episodes=1", "tracking.mlflow=false", "trust=true"])
    with pytest.raises(ConfigError, match=rf"{USER}\.SavesNothing can't be saved and restored"):
        evaluate_run(request)
    assert not (directory / "evaluations").exists()


def test_a_checkpoint_is_not_restored_into_a_class_that_has_lost_weights_since(tmp_path):
    """Neither is the model that was to be restored changed."""
    model = built(configured("sac"), seed=0).learn(60)
    folder = checkpoints.save(tmp_path / "checkpoints", model, checkpoints.Progress(step=60), tmp_path / "best.zip", 1)
    changed = built(configured("sac"), seed=1)
    changed.__class__ = user_algorithms.ForgetsOptimizer
    before = model_state(changed)
    with pytest.raises(ModelError, match=r"policy\.critic\.optimizer would be lost"):
        checkpoints.restore(folder, changed, tmp_path / "best.zip")
    assert model_state(changed) == before
