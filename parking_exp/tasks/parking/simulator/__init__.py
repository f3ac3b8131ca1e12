"""A vectorized simulator of parking, exact to highway-env, with NumPy alone."""

from parking_exp.tasks.parking.simulator.simulator import Simulator

__all__ = ["Simulator"]
