"""Models without logs, for tests that need no run."""

from stable_baselines3.common.logger import Logger

from parking_exp.algorithms.build_model import build_model
from parking_exp.config.compose import compose
from parking_exp.tasks.registry import make_task
from parking_exp.tasks.training_envs import make_training_envs


def make_model(*overrides, seed=0, **keywords):
    """The model of a config, in envs of its own."""
    return model_of(compose(*overrides), seed, **keywords)


def model_of(config, seed=0, **keywords):
    """The same of a config that is composed already."""
    task = make_task(config.env)
    envs = make_training_envs(task, config.n_envs)
    model = build_model(config, task, envs, seed, **keywords)
    model.set_logger(Logger(None, []))
    return model
