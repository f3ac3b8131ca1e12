"""Check that an algorithm's files hold all of its weights, before it trains or is evaluated."""

from hydra.utils import get_object

from parking_exp.algorithms.build_model import build_model
from parking_exp.algorithms.model_files import PROVEN, class_path, saving_problem
from parking_exp.config.schema import RunConfig
from parking_exp.envs.training_envs import make_training_envs
from parking_exp.errors import ConfigError, ModelError


def check_saving(config: RunConfig) -> None:
    """Refuse a config whose models have weights that their files would not hold. Classes in `PROVEN` are passed.

    Raises:
        ConfigError: with the names of these weights.
    """
    target, own_networks = config.algorithm.target, config.algorithm.arguments.get("policy_kwargs")
    if class_path(get_object(target)) in PROVEN and not own_networks:
        return
    env = make_training_envs(config.env, 1)
    try:
        if problem := saving_problem(build_model(config, env, seed=0, for_training=False)):
            raise ModelError(problem)
    except ModelError as error:
        raise ConfigError(f"algorithm._target_={target} can't be saved and restored exactly: {error}") from error
    finally:
        env.close()
