"""Collisions of rectangles, against highway-env's own polygon test."""

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting
from hypothesis import given, settings
from hypothesis import strategies as st

from parking_exp.envs.simulator.collisions import corners, separating_axis
from parking_exp.envs.simulator.dynamics import limited_acceleration

coordinate = st.floats(-6, 6)
angle = st.one_of(st.floats(-7, 7), st.sampled_from([0.0, np.pi / 2, -np.pi / 2]))
length = st.sampled_from([1.0, 2.0, 5.0, 42.0, 70.0])
rectangle = st.tuples(coordinate, coordinate, angle, length, length)


def polygon(x, y, heading, long, wide):
    direction = np.array([[np.cos(heading), np.sin(heading)]])
    return corners(np.array([[x, y]]), direction, np.array([long]), np.array([wide]))[0]


@settings(max_examples=500, deadline=None)
@given(rectangle, rectangle, st.tuples(coordinate, coordinate))
def test_separating_axis_is_highway_envs(first, second, displacement):
    a, b = polygon(*first), polygon(*second)
    now, soon, push = separating_axis(np.stack([a, b])[None], np.array([displacement]))
    closed = [np.vstack([points, points[:1]]) for points in (a, b)]
    their_now, their_soon, their_push = are_polygons_intersecting(*closed, np.array(displacement), np.zeros(2))
    assert (bool(now[0]), bool(soon[0])) == (their_now, their_soon)
    if their_soon:
        np.testing.assert_array_equal(push[0], their_push)


@pytest.mark.parametrize(("speed", "expected"), [(3.0, 1.0), (6.0, -1.0), (5.0, 1.0), (-4.0, 2.0)])
def test_a_car_beyond_its_limits_is_brought_back(speed, expected):
    limited = limited_acceleration(np.array([1.0]), np.array([speed]), (-2.0, 5.0))
    assert limited.tolist() == [expected]
