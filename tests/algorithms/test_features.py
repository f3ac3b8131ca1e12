"""The ego frame, exactly."""

import math

import numpy as np
import pytest
import torch

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.features import EgoFrameExtractor, FineEgoFrameExtractor
from parking_exp.tasks.parking.highway import make_parking_env

SCALES = [100, 100, 5, 5, 1, 1]
WEIGHTS = [1, 0.3, 0, 0, 0.02, 0.02]


def observed(x, y, heading, speed=0):
    """Pose and velocity, in metres and radians, as the env scales them."""
    cos, sin = math.cos(heading), math.sin(heading)
    values = np.array([x, y, speed * cos, speed * sin, cos, sin]) / SCALES
    return torch.tensor(values, dtype=torch.float32)[None]


def features(car, goal, make=EgoFrameExtractor):
    """Features for (x, y, heading, speed) of the car and the same of the goal."""
    space = make_parking_env(compose().env).observation_space
    entries = {"observation": observed(*car), "achieved_goal": observed(*car)}
    return make(space)(entries | {"desired_goal": observed(*goal)})[0].tolist()


@pytest.mark.parametrize(
    ("car", "goal", "part", "expected"),
    [
        # The car looks along +y; 20 m ahead of it and 10 m to its left the slot looks along -x.
        ((0, 0, math.pi / 2, 2.5), (-10, 20, math.pi), slice(None),
         [2.0, 1.0, 0.0, 1.0, 0.5, math.sqrt(5), 0.0, 0.0, 0.0, 1.0]),
        ((0, 0, 0.3, -5), (10, 0, 0), slice(4, 5), [-1.0]),  # backwards
        ((35, -21, 0, 0), (0, 0, 0), slice(6, None), [1.0, -1.0, 1.0, 0.0]),  # scaled by the walls
    ],
)  # fmt: skip
def test_the_goal_in_the_cars_frame_its_speed_and_its_pose_in_the_lot(car, goal, part, expected):
    assert features(car, goal)[part] == pytest.approx(expected, abs=1e-6)


def test_goal_features_do_not_depend_on_where_the_scene_lies():
    original = features(car=(0, 0, 0.4, 1), goal=(7, 3, 1.0))
    turn = 0.9
    shift = np.array([4.0, -2.0])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    goal = rotation @ [7, 3] + shift
    moved = features(car=(*shift, 0.4 + turn, 1), goal=(*goal, 1.0 + turn))
    assert moved[:6] == pytest.approx(original[:6], abs=1e-5)


def fine(weights=WEIGHTS):
    return lambda space: FineEgoFrameExtractor(space, weights)


def test_the_goal_at_the_scale_of_a_slot():
    # 1 m before a slot, 0.5 m beside it, at the same heading.
    computed = features((0, 0, 0, 5), (1, 0.5, 0), fine())
    assert computed[:6] == pytest.approx(features((0, 0, 0, 5), (1, 0.5, 0))[:6], abs=1e-6)
    near = [math.tanh(0.5), math.tanh(0.25), -math.tanh(0.5), -math.tanh(0.25)]
    assert computed[14:] == pytest.approx([*near, math.sqrt(0.01 + 0.3 * 0.005)], abs=1e-6)


def test_the_car_in_the_goals_frame():
    # The slot looks along +y; the car is 6 m before it and 3 m to its right, and drives along -x.
    computed = features((3, 8, math.pi, 2.5), (0, 14, math.pi / 2), fine())
    assert computed[10:14] == pytest.approx([-0.6, -0.3, 0.0, 0.5], abs=1e-6)
    assert computed[16:18] == pytest.approx([math.tanh(-3), math.tanh(-1.5)], abs=1e-6)


def test_the_speed_of_a_goal_is_seen_where_the_reward_weighs_velocity():
    weights = [1, 0.3, 0.1, 0.1, 0.02, 0.02]
    computed = features((0, 0, 0, 0), (0, 0, 0, -2.5), fine(weights))
    assert computed[18:] == pytest.approx([math.sqrt(0.1 * 0.5), -0.5], abs=1e-6)
    assert len(features((0, 0, 0, 0), (0, 0, 0, -2.5), fine())) == 19
