"""Plan paths of Reeds-Shepp curves with OMPL (Sucan, Moll and Kavraki 2012)."""

import time
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from ompl import base, geometric, util

from parking_exp.tasks.parking.free_space import FreeSpace

RANGE_M = 0.5  # the longest new branch of a tree: in tight slots, longer ones hit something
CHECK_M = 0.1  # between the poses of a motion that are tested
SAMPLE_M = 0.02  # between the poses of a path


def plan_path(
    start: np.ndarray,
    goal: np.ndarray,
    space: FreeSpace,
    *,
    planner: str,
    radius_m: float,
    time_limit_s: float,
    seed: int,
) -> np.ndarray:
    """Return a path from one pose of the rear axle to another, or the start if none was found.

    Args:
        start, goal: poses, shape (3,) [m, m, rad].
        space: the free space, in which the path lies.
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

    states = _states_of(space, radius_m)
    problem = geometric.SimpleSetup(states)
    information = problem.getSpaceInformation()
    motions = _MotionValidator(information, states, space, is_over)
    information.setMotionValidator(motions)
    problem.setStateValidityChecker(lambda state: space.contains(_pose(state)[None]))
    problem.setStartAndGoalStates(_state(states, start), _state(states, goal))
    problem.setOptimizationObjective(_any_path(information))
    problem.setPlanner(_solver(planner, information))

    try:
        problem.solve(base.PlannerTerminationCondition(is_over))
        if not problem.haveExactSolutionPath():
            return start[None]
        path = problem.getSolutionPath()
        geometric.PathSimplifier(information).reduceVertices(path)
        return _poses(states, path)
    finally:
        # Our class would otherwise keep the problem in memory, and it keeps the class.
        information.setMotionValidator(base.ReedsSheppMotionValidator(information))


def _states_of(space: FreeSpace, radius_m: float) -> Any:
    """Return the poses between the walls, joined by curves with a smallest radius."""
    states = base.ReedsSheppStateSpace(radius_m)
    bounds = base.RealVectorBounds(2)
    for axis, half in enumerate(space.half_box[:, 0].tolist()):
        bounds.setLow(axis, -half)
        bounds.setHigh(axis, half)
    states.setBounds(bounds)
    return states


def _solver(planner: str, information: Any) -> Any:
    """Return one of OMPL's planners; the branches of a tree are short."""
    solver = getattr(geometric, planner)(information)
    if hasattr(solver, "setRange"):
        solver.setRange(RANGE_M)
    return solver


class _MotionValidator(base.MotionValidator):
    """Tests all poses of a motion at once."""

    def __init__(
        self, information: Any, states: Any, space: FreeSpace, is_over: Callable[[], bool]
    ) -> None:
        super().__init__(information)
        self._states = states
        self._space = space
        self._is_over = is_over
        self._previous = np.empty((2, 3))

    def checkMotion(self, first: Any, second: Any) -> bool:  # OMPL's name
        # RRTConnect connects its trees step by step, each from the nearest state. Rounding may make
        # OMPL's distances grow on the way; it would then repeat a step forever.
        ends = np.stack([_pose(first), _pose(second)])
        is_repeated = np.array_equal(ends, self._previous)
        self._previous = ends
        if is_repeated or self._is_over():
            return False
        return self._space.contains(_motion(self._states, first, second, CHECK_M))


def _any_path(information: Any) -> Any:
    """Return an objective that any path meets, so that all planners stop at their first."""
    objective = base.PathLengthOptimizationObjective(information)
    objective.setCostThreshold(base.Cost(np.inf))
    return objective


def _state(states: Any, pose: np.ndarray) -> Any:
    state = states.allocState()
    x, y, heading = pose.tolist()
    state.setXY(x, y)
    state.setYaw(heading)
    states.enforceBounds(state)
    return state


def _pose(state: Any) -> np.ndarray:
    return np.array([state.getX(), state.getY(), state.getYaw()])


def _motion(states: Any, first: Any, second: Any, step_m: float) -> np.ndarray:
    """Return poses from one state to another, both included, shape (n, 3)."""
    n = int(np.ceil(states.distance(first, second) / step_m)) + 1
    between = states.allocState()
    poses = np.empty((n + 1, 3))
    for index, share in enumerate(np.linspace(0, 1, n + 1).tolist()):
        states.interpolate(first, second, share, between)
        poses[index] = _pose(between)
    return poses


def _poses(states: Any, path: Any) -> np.ndarray:
    """Return the poses of a path."""
    corners = path.getStates()
    motions = [_pose(corners[0])[None]]
    for first, second in pairwise(corners):
        motions.append(_motion(states, first, second, SAMPLE_M)[1:])
    poses = np.concatenate(motions)
    poses[:, 2] = np.unwrap(poses[:, 2])
    return poses
