"""Record episodes as a video. Rendering is headless: pygame draws on surfaces in memory."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import imageio.v2 as iio
import numpy as np
from PIL import Image, ImageDraw

from parking_exp.config.schema import EnvConfig
from parking_exp.envs.highway import make_env
from parking_exp.envs.interface import Policy
from parking_exp.envs.outcomes import outcome
from parking_exp.runs.atomic_files import replacing

LAST_FRAME_S = 1.0  # how long the end of an episode is shown
LONGEST_EPISODE_S = 20.0  # a timeout lasts 100 s, and shows mostly a car that does not move


def record(policy: Policy, env: EnvConfig, scenes: Sequence[int], path: Path, gif: bool = False) -> int:
    """Record one episode of each scene in one mp4 (and, besides it, a GIF of the same name).

    A second of video is a second of driving: one frame for the start of each episode, one for each simulation frame,
    and one second of its end. Episodes are cut after `LONGEST_EPISODE_S` seconds. Return the number of frames.
    """
    # SDL draws without a display; with its `dummy` driver highway-env would draw nothing at all.
    os.environ["SDL_VIDEODRIVER"] = "offscreen"
    path.parent.mkdir(parents=True, exist_ok=True)
    rate = env.simulation_frequency
    # Every third frame and a palette: a README's picture should not weigh megabytes.
    number, stride, gif_frames = 0, max(1, rate // 5), []
    with replacing(path) as temporary:
        video: Any = iio.get_writer(temporary, format="FFMPEG", fps=rate, codec="libx264", macro_block_size=2)
        with video:
            for number, frame in enumerate(_frames(policy, env, scenes), start=1):
                video.append_data(frame)
                if gif and number % stride == 1 % stride:
                    gif_frames.append(Image.fromarray(frame).quantize(64))
    if gif:
        first, *rest = gif_frames
        duration_ms = 1000 * stride / rate
        first.save(path.with_suffix(".gif"), save_all=True, append_images=rest, duration=duration_ms, loop=0)
    return number


def _frames(policy: Policy, config: EnvConfig, scenes: Sequence[int]) -> Iterator[np.ndarray]:
    with closing(make_env(config, render_mode="rgb_array")) as env:
        lot: Any = env.unwrapped
        draw: Callable[[], np.ndarray] = lot.render
        frames: list[np.ndarray] = []
        lot.render = lambda: frames.append(draw())  # highway-env calls it between two policy steps, too
        env.reset()
        lot.render()  # makes the viewer, whose camera would follow the car: keep the whole lot in sight instead
        lot.viewer.window_position = lambda: np.zeros(2)
        for scene in scenes:
            observation, info = env.reset(seed=scene)
            steps, done = 0, False
            frames[:] = [draw()]
            while True:
                yield from (_captioned(frame, f"scene {scene}") for frame in frames)
                if done or steps >= LONGEST_EPISODE_S * config.policy_frequency:
                    break
                action = policy({key: value[np.newaxis] for key, value in observation.items()})[0]
                frames.clear()
                observation, _, terminated, truncated, info = env.step(action)
                steps, done = steps + 1, terminated or truncated
                lot.render()
            ending = outcome(info["crashed"], info["is_success"]) if done else f"cut after {LONGEST_EPISODE_S:.0f} s"
            last = _captioned(frames[-1], f"scene {scene}: {ending}")
            yield from [last] * round(LAST_FRAME_S * config.simulation_frequency)


def _captioned(frame: np.ndarray, text: str) -> np.ndarray:
    image = Image.fromarray(frame)
    ImageDraw.Draw(image).text((8, 6), text, fill="white", stroke_width=1, stroke_fill="black", font_size=16)
    return np.asarray(image)
