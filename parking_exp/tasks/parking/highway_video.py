"""Frames of parking episodes, drawn by highway-env without a display: pygame draws in memory."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import islice
from typing import Any

import gymnasium as gym
import numpy as np

from parking_exp.tasks.env_batch import EnvBatch
from parking_exp.tasks.episode_frames import episode_frames
from parking_exp.tasks.parking.highway import make_parking_env, skip_unused_work
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.rollout import rollout
from parking_exp.tasks.task import Policy

MAX_EPISODE_S = 20  # a timeout lasts 100 s, and shows mostly a car that does not move


def frames(policy: Policy, config: ParkingConfig, seeds: Sequence[int]) -> Iterator[np.ndarray]:
    """Yield each episode's frames: its start, all simulation frames, and a second of its end.

    Episodes are cut after `MAX_EPISODE_S` seconds.
    """
    # SDL draws without a display; with its `dummy` driver highway-env would draw nothing at all.
    os.environ["SDL_VIDEODRIVER"] = "offscreen"
    with closing(make_parking_env(config, render_mode="rgb_array")) as env:
        draw = _camera(env)
        for seed in seeds:
            batch = EnvBatch([env], [seed], "crashed")
            skip_unused_work(env)
            steps = rollout(policy, batch, [seed])
            yield from episode_frames(
                islice(steps, MAX_EPISODE_S * config.policy_frequency),
                draw,
                f"scene {seed}",
                "crash",
                config.simulation_frequency,
                cut=f"cut after {MAX_EPISODE_S} s",
            )


def _camera(env: gym.Env) -> Callable[[], list[np.ndarray]]:
    """Return a function that draws the whole lot, and returns the frames since its last call."""
    parking_env: Any = env.unwrapped
    render: Callable[[], np.ndarray] = parking_env.render
    images: list[np.ndarray] = []
    # highway-env calls it between two policy steps, too.
    parking_env.render = lambda: images.append(render())

    def draw() -> list[np.ndarray]:
        parking_env.render()
        drawn = images.copy()
        images.clear()
        return drawn

    env.reset()
    draw()  # makes the viewer, whose camera would follow the car
    parking_env.viewer.window_position = lambda: np.zeros(2)
    return draw
