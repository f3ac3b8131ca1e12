"""Frames of the episodes of a video, with captions."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from PIL import Image, ImageDraw

from parking_exp.tasks.metrics import outcome
from parking_exp.tasks.rollout import Rollout

LAST_FRAME_S = 1.0  # how long the end of an episode is shown


def episode_frames(
    steps: Rollout,
    draw: Callable[[], Sequence[np.ndarray]],
    caption: str,
    failure: str,
    frame_rate: int,
    cut: str = "",
) -> Iterator[np.ndarray]:
    """Yield the frames of an episode, and repeat the last one for a second.

    Args:
        steps: the steps of a batch of this episode alone. They may stop before it ends.
        draw: returns the frames since its last call, each of shape (height, width, 3).
        caption: the text in each frame. The last frame also says how the episode ended.
        failure: the task's name for the outcome of a failed episode.
        frame_rate: frames per second.
        cut: what the last frame says if the steps stop before the episode ends.
    """
    ending = cut
    frames = draw()
    for frame in frames:
        yield _write_caption(frame, caption)

    for _, _, step in steps:
        frames = draw()
        for frame in frames:
            yield _write_caption(frame, caption)
        if step.terminated[0] or step.truncated[0]:
            ending = outcome(failure, step.failed[0], step.is_success[0])

    last = _write_caption(frames[-1], f"{caption}: {ending}")
    yield from [last] * round(LAST_FRAME_S * frame_rate)


def _write_caption(frame: np.ndarray, text: str) -> np.ndarray:
    """Return a frame with a text in its corner."""
    image = Image.fromarray(frame)
    ImageDraw.Draw(image).text(
        (8, 6), text, fill="white", stroke_width=1, stroke_fill="black", font_size=16
    )
    return np.asarray(image)
