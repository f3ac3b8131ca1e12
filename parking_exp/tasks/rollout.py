"""Step episodes that are simulated together to their ends."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from parking_exp.tasks.task import EvaluationBatch, Policy, Step, Task

Rollout = Iterator[tuple[np.ndarray, np.ndarray, Step]]
"""For each step: episode numbers, shape (n,), their actions, shape (n, actions), and the step."""


def seed_batches(seeds: Sequence[int], task: Task, policy: Policy) -> Iterator[list[int]]:
    """Yield seeds in batches of as many episodes as both the task and the policy run together."""
    batch_size = min(task.batch_size, policy.max_batch_size)
    for first in range(0, len(seeds), batch_size):
        yield list(seeds[first : first + batch_size])


def rollout(
    policy: Policy,
    batch: EvaluationBatch,
    seeds: Sequence[int],
    on_progress: Callable[[], None] | None = None,
) -> Rollout:
    """Step a batch until all episodes have ended.

    An episode leaves the batch after its last step was yielded.

    Args:
        policy: chooses the actions.
        batch: the episodes, at their start.
        seeds: the seeds from which they start, for the policy.
        on_progress: called while the policy prepares; may raise to stop.
    """
    policy.start(seeds, on_progress)
    observation = batch.observe()
    episodes = np.arange(len(batch))
    while len(batch):
        actions = policy(observation)
        step = batch.step(actions)
        yield episodes, actions, step

        observation = step.observation
        under_way = ~(step.terminated | step.truncated)
        if not under_way.all():
            batch.keep(under_way)
            policy.keep(under_way)
            episodes = episodes[under_way]
            observation = {key: values[under_way] for key, values in observation.items()}
