"""Videos of episodes."""

import numpy as np
import pytest
from support.runs import make_config

from parking_exp.evaluation.video import record


@pytest.mark.slow
def test_an_episode_is_left_after_20_seconds(tmp_path):
    def stand(observation):
        return np.zeros((len(observation["observation"]), 2), np.float32)

    # Its start, three simulation frames of each of 100 steps, and a second of its end at 15 frames a second.
    assert record(stand, make_config().env, [0], tmp_path / "video.mp4") == 1 + 3 * 100 + 15
