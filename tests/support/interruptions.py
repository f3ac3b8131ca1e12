"""Interrupt runs of this process where a kill may."""

from contextlib import contextmanager

import pytest

from parking_exp.training.training_session import RolloutCallback


class InterruptionError(BaseException):
    """Stands for a kill in a run of this process."""


@contextmanager
def cut(owner, name, when):
    """Raise at the first call of a method or function for whose arguments `when` is true."""
    original = getattr(owner, name)

    def cutting(*arguments, **keywords):
        if when(*arguments):
            raise InterruptionError
        return original(*arguments, **keywords)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, cutting)
        yield


def cut_at(step):
    """Inside a step: its transition is counted and not stored."""
    return cut(RolloutCallback, "_on_step", lambda callback: callback.num_timesteps >= step)
