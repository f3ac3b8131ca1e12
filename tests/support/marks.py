"""Marks of tests."""

import pytest


def slow_but(fast, values, *, several=False):
    """All values of a parameter, or tuples of several parameters, of which only `fast` belong to
    the fast suite.
    """
    return [
        value
        if value in fast
        else pytest.param(*(value if several else [value]), marks=pytest.mark.slow)
        for value in values
    ]
