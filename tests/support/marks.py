"""Marks of tests."""

import pytest


def slow_but(fast, values):
    """All values of a parameter, of which only those in `fast` belong to the fast suite."""
    return [value if value in fast else pytest.param(value, marks=pytest.mark.slow) for value in values]
