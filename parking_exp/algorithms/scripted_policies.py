"""Make scripted policies by the dotted paths of their classes."""

from collections.abc import Mapping
from typing import Any

from hydra.utils import get_class

from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import Task


def build_scripted_policy(
    target: str, arguments: Mapping[str, Any], task: Task, seed: int
) -> ScriptedPolicy:
    """Return a policy for the episodes of a task.

    Args:
        target: dotted path of its class.
        arguments: of its constructor, beside the next two.
        task: whose episodes it is for.
        seed: of its random numbers.
    """
    policy: ScriptedPolicy = get_class(target)(task, seed, **arguments)
    return policy
