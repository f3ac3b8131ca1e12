"""Record episodes as a video."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio.v2 as iio

from parking_exp.runs.atomic_files import replacing
from parking_exp.tasks.task import Policy, Task


def record(policy: Policy, task: Task, seeds: Sequence[int], path: Path) -> None:
    """Record one episode from each seed in one mp4."""
    with replacing(path) as temporary:
        options: dict[str, Any] = {"fps": task.frame_rate, "codec": "libx264", "macro_block_size": 2}
        video: Any = iio.get_writer(temporary, format="FFMPEG", **options)
        with video:
            for frame in task.frames(policy, seeds):
                video.append_data(frame)
