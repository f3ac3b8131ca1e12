"""Every env that a command makes is closed when the command is over."""

from dataclasses import dataclass, field

import gymnasium as gym
import pytest
from support.runs import call_script

TINY = (
    "n_envs=2",
    "updates_per_step=0.5",
    "total_timesteps=100",
    "algorithm.learning_starts=50",
    "evaluation.every_n_steps=60",
    "evaluation.n_scenes=2",
    "evaluation.final_n_scenes=6",
    "evaluation.video_episodes=1",
    "tracking.mlflow=false",
)
SMOKE = ("experiment=smoke", *TINY)
ENVS = {
    # Six episodes of the cross-check, and the video.
    "parking, simulated": (SMOKE, 6 + 1),
    # Two training envs, evaluations of two and six episodes, and the video.
    "parking on highway-env": ((*SMOKE, "env.simulator=highway_env"), 2 + 2 + 6 + 1),
}
BIT_FLIP = ("env=gymnasium", "env.id=support.toy_tasks:BitFlip-v0", *TINY)


@dataclass
class Envs:
    """The envs that Gymnasium has made, and which of them were closed."""

    made: list[gym.Env] = field(default_factory=list)
    closed: set[int] = field(default_factory=set)

    def count(self):
        """Return how many envs were made, and how many of them were closed."""
        return len(self.made), len(self.closed)


@pytest.fixture
def envs(monkeypatch):
    """The envs that are made within a test."""
    envs = Envs()
    make = gym.make

    def make_counted(*arguments, **options):
        env = make(*arguments, **options)
        inner = env.unwrapped
        close = inner.close

        def close_counted():
            envs.closed.add(id(inner))
            close()

        inner.close = close_counted
        envs.made.append(inner)
        return env

    monkeypatch.setattr(gym, "make", make_counted)
    return envs


@pytest.mark.parametrize("kind", ENVS)
def test_a_training_closes_the_envs_of_its_evaluations_cross_check_and_video(kind, envs, tmp_path):
    overrides, number = ENVS[kind]
    call_script("train", *overrides, f"output_dir={tmp_path}", code=0)
    assert envs.count() == (number, number)


def test_a_training_closes_environments_of_gymnasium(envs, tmp_path):
    call_script("train", *BIT_FLIP, f"output_dir={tmp_path}", code=0)
    n_made, n_closed = envs.count()
    assert n_made > 0
    assert n_closed == n_made


def test_an_evaluation_closes_its_envs_and_that_of_the_model(envs, tmp_path):
    arguments = ("run=pretrained", "episodes=3", "simulator=highway_env")
    call_script("evaluate", *arguments, f"output_dir={tmp_path}", code=0)
    assert envs.count() == (3 + 1, 3 + 1)


def test_an_export_closes_the_env_of_the_model(envs, tmp_path):
    arguments = ("run=pretrained", "format=safetensors")
    call_script("export", *arguments, f"output_dir={tmp_path}", code=0)
    assert envs.count() == (1, 1)
