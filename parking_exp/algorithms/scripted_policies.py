"""Make the scripted policy that a config describes."""

from hydra.utils import get_class

from parking_exp.config.schema import RunConfig
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import Task


def build_scripted_policy(config: RunConfig, task: Task) -> ScriptedPolicy:
    """Return the policy of a run that is not trained, for a task like the run's."""
    policy: ScriptedPolicy = get_class(config.algorithm.target)(
        task, config.seed, **config.algorithm.arguments
    )
    return policy
