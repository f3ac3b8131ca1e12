"""The agent that plans."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any, Literal

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat

from parking_exp.tasks.parking.free_space import FreeSpace
from parking_exp.tasks.parking.geometry import CAR_LENGTH_M, REAR_AXLE_M, move_ahead
from parking_exp.tasks.parking.lot import lot_of
from parking_exp.tasks.parking.parking_config import RANGES, ParkingConfig
from parking_exp.tasks.parking.parking_task import ParkingTask
from parking_exp.tasks.parking.planning.controller import follow
from parking_exp.tasks.parking.planning.trajectory import Pace, make_trajectory
from parking_exp.tasks.parking.simulator.scene_state import SCALES
from parking_exp.tasks.scripted_policy import ScriptedPolicy
from parking_exp.tasks.task import Observation

OmplPlanner = Literal["RRTConnect", "RRT", "RRTstar", "InformedRRTstar", "BITstar", "FMT", "BFMT"]
"""Planners of OMPL that find paths here. PRM's threads would wait for Python forever."""
SPEED_MPS = 2.5
# Plans stay below the limits of the car, so that errors can be corrected.
LIMIT_FRACTION = 0.6  # share of the limits of speed and acceleration that plans use
RADIUS_FACTOR = 1.04  # factor on the car's smallest turning radius


@dataclass(frozen=True)
class Plan:
    """What was planned for a scene."""

    trajectory: np.ndarray  # shape (steps, REFERENCE)
    plan_s: float  # wall-clock time that it took


class Planner(ScriptedPolicy):
    """Plans a path on the map of a scene, and follows it; without a path, the car stands.

    Args:
        task: the parking task.
        seed: with the seed of a scene, the seed of its random numbers.
        planner: the name of one of OMPL's planners.
        margin_m: the smallest distance of the car on its path to everything else.
        time_limit_s: CPU time for the path of a scene.
    """

    task: ParkingTask

    def __init__(
        self,
        task: ParkingTask,
        seed: int,
        planner: OmplPlanner = "RRTConnect",
        margin_m: NonNegativeFloat = 0.1,
        time_limit_s: PositiveFloat = 10.0,
    ) -> None:
        super().__init__(task, seed)
        self._planner = planner
        self._margin_m = margin_m
        self._time_limit_s = time_limit_s
        config = task.config
        self._dt = 1 / config.simulation_frequency
        self._frames_per_step = config.frames_per_step
        self._low, self._high = np.transpose(config.action.ranges)
        limit = config.action.limit
        self._max_curvature = np.tan(limit("steering_range")) / CAR_LENGTH_M
        self._pace = Pace(
            step_s=self._dt * self._frames_per_step,
            speed_mps=min(SPEED_MPS, LIMIT_FRACTION * limit("speed_range")),
            acceleration_mps2=LIMIT_FRACTION * limit("acceleration_range"),
        )
        self._plans: dict[int, Plan] = {}
        self._batch: list[Plan] = []
        self._step = 0

    @classmethod
    def problems(cls, env: Any) -> Iterator[str]:
        """Yield why it can't plan: without OMPL, in another task, or for a car that can't turn or
        drive in both directions.
        """
        if find_spec("ompl") is None:
            yield "the planner needs ompl; pip install 'parking-exp[planning]'"
            return
        if not isinstance(env, ParkingConfig):
            yield f"the planner drives in parking tasks only; env={env.name} is another task"
            return
        for name in RANGES:
            if env.action.limit(name) <= 0:
                yield f"the planner needs an env.action.{name} of both directions"

    def start(self, seeds: Sequence[int], on_progress: Callable[[], None] | None = None) -> None:
        """Plan for the scenes that have no plan yet."""
        for seed in seeds:
            if seed not in self._plans:
                self._plans[seed] = self.plan(seed)
                if on_progress is not None:
                    on_progress()
        self._batch = [self._plans[seed] for seed in seeds]
        self._step = 0

    def __call__(self, observation: Observation) -> np.ndarray:
        """Return actions that follow the plans, shape (n, 2)."""
        rows = []
        for plan in self._batch:
            last = len(plan.trajectory) - 1
            rows.append(plan.trajectory[min(self._step, last)])
        self._step += 1
        poses = observation["achieved_goal"] * SCALES
        controls = follow(
            poses, np.array(rows), self._max_curvature, self._dt, self._frames_per_step
        )
        actions = 2 * (controls - self._low) / (self._high - self._low) - 1
        return np.clip(actions, -1, 1)

    def keep(self, rows: np.ndarray) -> None:
        """Keep only some scenes of the batch, by mask."""
        self._batch = [self._batch[row] for row in np.flatnonzero(rows)]

    def info(self, row: int) -> dict[str, float]:
        """Return how long the plan of a scene took."""
        return {"plan_s": self._batch[row].plan_s}

    def plan(self, seed: int) -> Plan:
        """Plan for the scene of `env.reset(seed=seed)`."""
        began = time.perf_counter()
        trajectory = make_trajectory(self.find_path(seed), self._pace)
        return Plan(trajectory, time.perf_counter() - began)

    def find_path(self, seed: int) -> np.ndarray:
        """Return the poses of the rear axle on the path of a scene, shape (n, 3) [m, m, rad].

        There is only the start if no path was found in time.
        """
        from parking_exp.tasks.parking.planning.path_search import plan_path

        config = self.task.config
        scenes = lot_of(config).from_seeds([seed])
        free_space = FreeSpace(scenes, walls=config.add_walls, margin_m=self._margin_m)
        # The numbers of a scene do not depend on the scenes before it.
        (path_seed,) = np.random.SeedSequence([self.seed, seed]).generate_state(1).tolist()
        return plan_path(
            move_ahead(scenes.start[0], -REAR_AXLE_M),
            move_ahead(scenes.goal_pose[0], -REAR_AXLE_M),
            free_space,
            planner=self._planner,
            radius_m=RADIUS_FACTOR / self._max_curvature,
            time_limit_s=self._time_limit_s,
            seed=max(path_seed, 1),
        )
