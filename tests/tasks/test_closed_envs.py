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
SMOKE = ("train", "experiment=smoke", *TINY)
PRETRAINED = "run=pretrained"
COMMANDS = {
    # Six episodes of the cross-check, and the video.
    "a training, simulated": (SMOKE, 6 + 1),
    # Two training envs, evaluations of two and six episodes, and the video.
    "a training on highway-env": ((*SMOKE, "env.simulator=highway_env"), 2 + 2 + 6 + 1),
    # Three episodes, and the env of the model.
    "an evaluation": (("evaluate", PRETRAINED, "episodes=3", "simulator=highway_env"), 3 + 1),
    # The env of the model.
    "an export": (("export", PRETRAINED, "format=safetensors"), 1),
}


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


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_command_closes_the_envs_that_it_makes(kind, envs, tmp_path):
    command, number = COMMANDS[kind]
    call_script(*command, f"output_dir={tmp_path}", code=0)
    assert envs.count() == (number, number)
