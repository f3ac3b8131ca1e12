"""Step episodes that are simulated together to their ends."""

from collections.abc import Iterator

import numpy as np

from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import EvaluationBatch, Policy, Step


def rollout(
    policy: Policy, batch: EvaluationBatch
) -> Iterator[tuple[np.ndarray, np.ndarray, Step]]:
    """Step a batch until all episodes have ended; the policy sees those that are under way.

    Yields:
        After each step: the numbers of the episodes that took it, shape (n,), their actions, shape
        (n, actions), and the step. What has ended leaves the batch afterwards.
    """
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
            if isinstance(policy, ScriptedPolicy):
                policy.keep(under_way)
            episodes = episodes[under_way]
            observation = {key: values[under_way] for key, values in observation.items()}
