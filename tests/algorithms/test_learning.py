"""Agents learn a goal-conditioned task with our HER buffer, and do not learn it without HER."""

import pytest
from support.marks import slow_but
from support.models import model_of
from support.reach import CHANCE
from support.user_tasks import write_option

from parking_exp.algorithms.build_model import GreedyPolicy
from parking_exp.algorithms.fast.fast_training import is_supported
from parking_exp.config.compose import compose
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.tasks.registry import make_task

# The bound and four standard deviations of a rate over 200 episodes: 1 %.
UNTRAINED = CHANCE + 4 * (CHANCE * (1 - CHANCE) / 200) ** 0.5
AS_SB3 = (
    "buffer.relabel_collision=sb3",
    "buffer.relabel_terminated=sb3",
    "buffer.goal_velocity=achieved",
)


def configured(folder, algorithm, *overrides):
    return compose(
        "env=steps",
        f"algorithm={algorithm}",
        "algorithm.features=raw",
        "algorithm.normalize=false",
        "algorithm.net_arch=[64,64]",
        "algorithm.batch_size=64",
        "algorithm.learning_starts=200",
        "algorithm.learning_rate=3e-3",
        "algorithm.gamma=0.9",
        "updates_per_step=1.0",
        "n_envs=4",
        *overrides,
        *([] if algorithm == "crossq" else ["algorithm.tau=0.02"]),
        *(["algorithm.action_noise=null"] if algorithm in {"td3", "ddpg"} else []),
        config_dir=write_option(folder, "support.reach.Reach"),
    )


def success_rate(config, model):
    """Return the share of goals that the model reaches, always in the same episodes."""
    episodes = evaluate_policy(GreedyPolicy(model), make_task(config.env), range(200))
    return (episodes["outcome"] == "success").mean()


STEPS_AND_RATE = {
    "sac": (3000, 0.95),
    "td3": (3000, 0.95),
    "ddpg": (3000, 0.95),
    "crossq": (8000, 0.2),
}


@pytest.mark.parametrize("algorithm", slow_but(["sac"], STEPS_AND_RATE))
def test_with_her_and_the_fast_update_an_agent_learns_to_reach_goals(algorithm, tmp_path):
    config = configured(tmp_path, algorithm, *AS_SB3)
    model = model_of(config)
    assert is_supported(model) == (algorithm != "crossq")
    assert success_rate(config, model) <= UNTRAINED
    steps, rate = STEPS_AND_RATE[algorithm]
    model.learn(steps)
    assert success_rate(config, model) >= rate


def test_without_her_it_does_not(tmp_path):
    """Rewards are -1 in all but one of about 1,000 episodes, and it sees 300."""
    config = configured(tmp_path, "sac", "buffer=replay")
    model = model_of(config)
    model.learn(3000)
    assert success_rate(config, model) <= UNTRAINED
