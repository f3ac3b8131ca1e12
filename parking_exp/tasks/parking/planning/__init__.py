"""A classical planner as an agent: it plans a path on the map of a scene, and follows it."""

from parking_exp.tasks.parking.planning.planner import Planner

__all__ = ["Planner"]
