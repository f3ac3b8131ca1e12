"""Frames of parking episodes, drawn by highway-env. Rendering is headless: pygame draws on surfaces
in memory.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from typing import Any

import numpy as np

from parking_exp.tasks.captions import LAST_FRAME_S, add_caption
from parking_exp.tasks.metrics import outcome
from parking_exp.tasks.parking.highway import make_env, skip_unused_work
from parking_exp.tasks.parking.parking_config import ParkingConfig
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import Policy

MAX_EPISODE_S = 20.0  # a timeout lasts 100 s, and shows mostly a car that does not move


def frames(policy: Policy, config: ParkingConfig, scenes: Sequence[int]) -> Iterator[np.ndarray]:
    """Yield one frame for the start of each episode, one for each simulation frame, and one second
    of its end.

    Episodes are cut after `MAX_EPISODE_S` seconds.
    """
    # SDL draws without a display; with its `dummy` driver highway-env would draw nothing at all.
    os.environ["SDL_VIDEODRIVER"] = "offscreen"
    with closing(make_env(config, render_mode="rgb_array")) as env:
        lot: Any = env.unwrapped
        draw: Callable[[], np.ndarray] = lot.render
        images: list[np.ndarray] = []
        # highway-env calls it between two policy steps, too.
        lot.render = lambda: images.append(draw())
        env.reset()
        # makes the viewer, whose camera would follow the car: keep the whole lot in sight instead
        lot.render()
        lot.viewer.window_position = lambda: np.zeros(2)
        for scene in scenes:
            observation, info = env.reset(seed=scene)
            skip_unused_work(env)
            if isinstance(policy, ScriptedPolicy):
                policy.start([scene])
            steps = 0
            done = False
            images[:] = [draw()]
            while True:
                yield from (add_caption(frame, f"scene {scene}") for frame in images)
                if done or steps >= MAX_EPISODE_S * config.policy_frequency:
                    break
                batch = {key: value[np.newaxis] for key, value in observation.items()}
                action = policy(batch)[0]
                images.clear()
                observation, _, terminated, truncated, info = env.step(action)
                steps += 1
                done = terminated or truncated
                lot.render()
            ending = f"cut after {MAX_EPISODE_S:.0f} s"
            if done:
                ending = outcome("crash", info["crashed"], info["is_success"])
            last = add_caption(images[-1], f"scene {scene}: {ending}")
            yield from [last] * round(LAST_FRAME_S * config.simulation_frequency)
