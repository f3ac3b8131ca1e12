"""Record episodes as a video. Rendering is headless: pygame draws on surfaces in memory."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import gymnasium as gym
import imageio.v2 as iio
import numpy as np
from PIL import Image, ImageDraw

from parking_exp.config.schema import EnvConfig
from parking_exp.envs.highway import make_env
from parking_exp.envs.interface import Policy
from parking_exp.envs.outcomes import outcome
from parking_exp.evaluation.evaluate_policy import rollout
from parking_exp.runs.files import replacing

HOLD_S = 1.0  # how long the end of an episode stays in sight
MOST_S = 20.0  # of an episode: a timeout lasts 100 s, and is mostly a car that stands


def record(
    policy: Policy,
    env: EnvConfig,
    scenes: Sequence[int],
    path: Path,
    gif: bool = False,
    on_episode: Callable[[int], None] | None = None,
) -> int:
    """Record one episode of each scene in one mp4 (and, besides it, a GIF of the same name).

    A second of video is a second of driving: frames come at `simulation_frequency`, one for the start of each
    episode, one for each simulation frame, and `HOLD_S` seconds of the end. Episodes are left after `MOST_S` seconds.

    Args:
        policy: what is recorded.
        env: the `env` group.
        scenes: seeds of `env.reset`.
        path: of the mp4.
        gif: whether to make a GIF as well.
        on_episode: called after each episode with the number that are recorded.

    Returns:
        The number of frames.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rate = env.simulation_frequency
    # Every third frame and a palette: a README's picture should not weigh megabytes.
    number, stride, kept = 0, max(1, rate // 5), []
    with _headless(), replacing(path) as temporary:
        video: Any = iio.get_writer(temporary, format="FFMPEG", fps=rate, codec="libx264", macro_block_size=2)
        with video:
            for number, frame in enumerate(_frames(policy, env, scenes, on_episode), start=1):
                video.append_data(frame)
                if gif and number % stride == 1 % stride:
                    kept.append(Image.fromarray(frame).quantize(64))
    if gif:
        first, *rest = kept
        duration_ms = 1000 * stride / rate
        first.save(path.with_suffix(".gif"), save_all=True, append_images=rest, duration=duration_ms, loop=0)
    return number


class _IntermediateFrames:
    """What highway-env calls, in place of a RecordVideo wrapper, for the frames between two policy steps."""

    def __init__(self, env: gym.Env) -> None:
        self.env = env
        self.frames: list[np.ndarray] = []
        self.frames_per_sec = 0.0  # highway-env writes it

    def _capture_frame(self) -> None:
        self.frames.append(self.env.render())

    def take(self) -> list[np.ndarray]:
        taken, self.frames = self.frames, []
        return taken


def _frames(
    policy: Policy, config: EnvConfig, scenes: Sequence[int], on_episode: Callable[[int], None] | None
) -> Iterator[np.ndarray]:
    env = make_env(config, render_mode="rgb_array")
    try:
        env.reset()
        env.render()  # makes the viewer, whose camera would follow the car: keep the whole lot in sight instead
        env.unwrapped.viewer.window_position = lambda: np.zeros(2)
        between = _IntermediateFrames(env)
        env.unwrapped.set_record_video_wrapper(between)
        for number, scene in enumerate(scenes, start=1):
            for step, (_, info, done) in enumerate(rollout(policy, env, scene)):
                frame = env.render()
                for image in [*between.take(), frame]:
                    yield _captioned(image, f"scene {scene}")
                if done or step >= MOST_S * config.policy_frequency:
                    how = outcome(info["crashed"], info["is_success"]) if done else f"not there after {MOST_S:.0f} s"
                    end = _captioned(frame, f"scene {scene}: {how}")
                    yield from [end] * round(HOLD_S * config.simulation_frequency)
                    break
            if on_episode is not None:
                on_episode(number)
    finally:
        env.close()


def _captioned(frame: np.ndarray, text: str) -> np.ndarray:
    image = Image.fromarray(frame)
    ImageDraw.Draw(image).text((8, 6), text, fill="white", stroke_width=1, stroke_fill="black", font_size=16)
    return np.asarray(image)


@contextmanager
def _headless() -> Iterator[None]:
    """Let SDL draw without a display; with its `dummy` driver highway-env would draw nothing at all."""
    before = os.environ.get("SDL_VIDEODRIVER")
    os.environ["SDL_VIDEODRIVER"] = "offscreen"
    try:
        yield
    finally:
        if before is None:
            del os.environ["SDL_VIDEODRIVER"]
        else:
            os.environ["SDL_VIDEODRIVER"] = before
