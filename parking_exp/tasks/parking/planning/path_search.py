"""Plan paths of Reeds-Shepp curves with OMPL (Sucan, Moll and Kavraki 2012)."""

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from ompl import base, geometric, util

from parking_exp.tasks.parking.free_space import FreeSpace

RANGE_M = 0.5  # the longest new branch of a tree: in tight slots, longer ones hit something
CHECK_M = 0.1  # distance between the tested poses of a motion
SAMPLE_M = 0.02  # distance between the poses of a path


def plan_path(
    start: np.ndarray,
    goal: np.ndarray,
    free_space: FreeSpace,
    *,
    planner: str,
    radius_m: float,
    time_limit_s: float,
    seed: int,
) -> np.ndarray:
    """Return a path from one pose of the rear axle to another, or the start if none was found.

    Args:
        start, goal: poses, shape (3,) [m, m, rad].
        free_space: in which the path lies.
        planner: the name of a class in `ompl.geometric`.
        radius_m: the smallest radius of the rear axle.
        time_limit_s: the largest CPU time.
        seed: the seed of OMPL's random numbers, above 0.

    Returns:
        Poses that are close to each other, shape (n, 3); headings do not jump.
    """
    end = time.process_time() + time_limit_s

    def is_over() -> bool:
        return time.process_time() > end

    util.noOutputHandler()  # it warns that the seed is not the first of the process
    # Random numbers of planners and samplers that are made after this line follow from the seed.
    util.RNG.setSeed(seed)

    state_space = _make_state_space(free_space, radius_m)
    setup = geometric.SimpleSetup(state_space)
    space_information = setup.getSpaceInformation()
    motions = _MotionValidator(space_information, state_space, free_space, is_over)
    space_information.setMotionValidator(motions)
    setup.setStateValidityChecker(lambda state: free_space.contains(_to_pose(state)[None]))
    setup.setStartAndGoalStates(_to_state(state_space, start), _to_state(state_space, goal))
    setup.setOptimizationObjective(_make_objective(space_information))
    setup.setPlanner(_make_planner(planner, space_information))

    try:
        setup.solve(base.PlannerTerminationCondition(is_over))
        if not setup.haveExactSolutionPath():
            return start[None]
        path = setup.getSolutionPath()
        geometric.PathSimplifier(space_information).reduceVertices(path)
        return _interpolate_path(state_space, path)
    finally:
        # Our validator and the setup would otherwise keep each other in memory.
        space_information.setMotionValidator(base.ReedsSheppMotionValidator(space_information))


def _make_state_space(free_space: FreeSpace, radius_m: float) -> Any:
    """Return the Reeds-Shepp space of the poses between the walls, with a smallest radius."""
    state_space = base.ReedsSheppStateSpace(radius_m)
    bounds = base.RealVectorBounds(2)
    for axis, half in enumerate(free_space.free[:, 0].tolist()):
        bounds.setLow(axis, -half)
        bounds.setHigh(axis, half)
    state_space.setBounds(bounds)
    return state_space


def _make_planner(name: str, space_information: Any) -> Any:
    """Return one of OMPL's planners; the branches of a tree are short."""
    planner = getattr(geometric, name)(space_information)
    if hasattr(planner, "setRange"):
        planner.setRange(RANGE_M)
    return planner


class _MotionValidator(base.MotionValidator):
    """Tests all poses of a motion at once."""

    def __init__(
        self,
        space_information: Any,
        state_space: Any,
        free_space: FreeSpace,
        is_over: Callable[[], bool],
    ) -> None:
        super().__init__(space_information)
        self._state_space = state_space
        self._free_space = free_space
        self._is_over = is_over
        self._previous = np.full((2, 3), np.nan)  # no motion yet

    def checkMotion(self, first: Any, second: Any) -> bool:  # OMPL's name
        # RRTConnect connects its trees step by step, each from the nearest state. Rounding may make
        # OMPL's distances grow on the way; it would then repeat a step forever.
        ends = np.stack([_to_pose(first), _to_pose(second)])
        is_repeated = np.array_equal(ends, self._previous)
        self._previous = ends
        if is_repeated or self._is_over():
            return False
        return self._free_space.contains(_interpolate(self._state_space, first, second, CHECK_M))


def _make_objective(space_information: Any) -> Any:
    """Return an objective that any path meets, so that all planners stop at their first."""
    objective = base.PathLengthOptimizationObjective(space_information)
    objective.setCostThreshold(base.Cost(np.inf))
    return objective


def _to_state(state_space: Any, pose: np.ndarray) -> Any:
    state = state_space.allocState()
    x, y, heading = pose.tolist()
    state.setXY(x, y)
    state.setYaw(heading)
    state_space.enforceBounds(state)
    return state


def _to_pose(state: Any) -> np.ndarray:
    return np.array([state.getX(), state.getY(), state.getYaw()])


def _interpolate(state_space: Any, first: Any, second: Any, step_m: float) -> np.ndarray:
    """Return poses from one state to another, both included, shape (n, 3)."""
    n = int(np.ceil(state_space.distance(first, second) / step_m)) + 1
    between = state_space.allocState()
    poses = np.empty((n + 1, 3))
    for index, share in enumerate(np.linspace(0, 1, n + 1).tolist()):
        state_space.interpolate(first, second, share, between)
        poses[index] = _to_pose(between)
    return poses


def _interpolate_path(state_space: Any, path: Any) -> np.ndarray:
    """Return the poses of a path."""
    corners = path.getStates()
    motions = [_to_pose(corners[0])[None]]
    for first, second in pairwise(corners):
        motions.append(_interpolate(state_space, first, second, SAMPLE_M)[1:])
    poses = np.concatenate(motions)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses
