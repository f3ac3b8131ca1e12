"""Record episodes as a video."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import imageio.v2 as iio
from PIL import Image

from parking_exp.errors import VideoError, class_and_message
from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.task import Policy, Task


def record_video(
    policy: Policy, task: Task, seeds: Sequence[int], path: Path, gif: bool = False
) -> str | None:
    """Record one episode from each seed in one mp4, and with `gif` also a GIF of the same name.

    Errors of drivers, shared libraries and the environment's own code cost the video only.

    Returns:
        None if there is a video, else a sentence that says why there is none.
    """
    try:
        _write_files(policy, task, seeds, path, gif)
    except VideoError as error:
        return str(error)
    except (Exception, SystemExit) as error:
        return f"no video of {task.env_id}: {class_and_message(error)}"
    return None


def _write_files(policy: Policy, task: Task, seeds: Sequence[int], path: Path, gif: bool) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    stride = max(1, task.frame_rate // 5)  # few frames: a GIF small enough for a README
    gif_frames = []
    with replacing(path) as temporary:
        video: Any = iio.get_writer(
            temporary, format="FFMPEG", fps=task.frame_rate, codec="libx264", macro_block_size=2
        )
        with closing(video):  # as a context manager, it would leave ffmpeg running after an error
            for number, frame in enumerate(task.frames(policy, seeds)):
                video.append_data(frame)
                if gif and number % stride == 0:
                    gif_frames.append(Image.fromarray(frame).quantize(64))
    if gif:
        first, *rest = gif_frames
        with replacing(path.with_suffix(".gif")) as temporary:
            first.save(
                temporary,
                save_all=True,
                append_images=rest,
                duration=1000 * stride / task.frame_rate,
                loop=0,
            )
