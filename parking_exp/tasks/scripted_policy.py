"""Policies that are written by hand, or plan, and are not trained."""

from collections.abc import Iterator, Mapping
from typing import Any

from parking_exp.dotted_paths import import_object
from parking_exp.tasks.task import Policy, Task


class ScriptedPolicy(Policy):
    """A policy that is not trained and knows the seeds of its episodes.

    `algorithm._target_` names a subclass, and `algorithm.trained` is false. Other keys of
    `algorithm` are arguments of its constructor, which are checked by their annotations, such as
    pydantic's `PositiveFloat`. Do not name an argument as Stable-Baselines3's algorithms do, such
    as `gamma` or `batch_size`: these keys are left out where nothing is trained.

    Args:
        task: the task of its episodes.
        seed: the seed of its random numbers, which is the run's.
    """

    max_batch_size = 20  # a planner takes seconds for it, after which progress is shown

    def __init__(self, task: Task, seed: int) -> None:
        self.task = task
        self.seed = seed

    @classmethod
    def problems(cls, env: Any) -> Iterator[str]:
        """Yield a sentence for each reason why it can't act in the env of a config."""
        yield from ()


def build_scripted_policy(
    target: str, arguments: Mapping[str, Any], task: Task, seed: int
) -> ScriptedPolicy:
    """Return a policy for the episodes of a task.

    Args:
        target: the dotted path of its class.
        arguments: further arguments of its constructor.
        task: the task of its episodes.
        seed: the seed of its random numbers.
    """
    policy: ScriptedPolicy = import_object(target)(task, seed, **arguments)
    return policy
