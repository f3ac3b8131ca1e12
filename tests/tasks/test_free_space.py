"""Poses at which a car touches something are those where its rectangle does."""

import numpy as np
import pytest
from shapely import box
from support.shapes import polygon

from parking_exp.config.compose import compose
from parking_exp.tasks.parking.free_space import FreeSpace
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, CAR_WIDTH_M, OBSTACLE_M
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.scenes import NO_SLOT

LOTS = (
    ["env=parking_parallel", "env.level=hard"],
    ["env=parking_bays", "env.level=normal"],
    ["env=parking_lots", "env.level=normal"],
    ["env=parking_crowded", "env.obstacles=3"],
)


def touches(scenes, poses, **arguments):
    return FreeSpace(scenes, **arguments).touches(poses)


def shapes_of(scenes, row):
    """What stands in a scene, and the space between its walls."""
    parked = [
        polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
        for pose, slot in zip(scenes.vehicle_pose[row], scenes.vehicles[row], strict=True)
        if slot != NO_SLOT
    ]
    obstacles = [polygon(*place, 0.0, OBSTACLE_M, OBSTACLE_M) for place in scenes.obstacles[row]]
    half_x, half_y = scenes.free[:, row]
    return parked + obstacles, box(-half_x, -half_y, half_x, half_y)


@pytest.mark.parametrize("overrides", LOTS)
def test_contacts_are_those_of_the_shapes(overrides):
    scenes = lot_of(compose(*overrides).env).from_seeds(range(20))
    rng = np.random.default_rng(0)
    around_goals = scenes.goal_pose[:, None] + rng.normal(0, [3, 3, 1], (20, 50, 3))
    touching = touches(scenes, around_goals, walls=True)
    assert 0.2 < touching.mean() < 0.9
    for row in range(20):
        others, inside = shapes_of(scenes, row)
        for pose, expected in zip(around_goals[row], touching[row], strict=True):
            car = polygon(*pose, CAR_LENGTH_M, CAR_WIDTH_M)
            hit = any(car.intersects(other) for other in others) or not inside.contains(car)
            assert hit == expected


def test_a_margin_is_kept_on_all_sides():
    env = compose("env=parking_parallel", "env.lot.slot_length_m=7").env
    scenes = lot_of(env).from_seeds([0])
    at_goal = scenes.goal_pose[:, None]  # 2 m from the cars before and behind, 1 m from the wall
    assert not touches(scenes, at_goal, walls=False, margin_m=1.99).any()
    assert touches(scenes, at_goal, walls=False, margin_m=2.01).all()
    assert not touches(scenes, at_goal, walls=True, margin_m=0.99).any()
    assert touches(scenes, at_goal, walls=True, margin_m=1.01).all()
