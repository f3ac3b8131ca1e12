"""Hydra-configured experiment sweeps for goal-conditioned parking.

`compose` makes the checked config of a run, `train` trains it, `load` reads the results of many
runs, and `load_model` a trained agent:

    from parking_exp import compose, load, load_model, train

    result = train(compose("experiment=smoke"))
    frames = load("smoke")
    model = load_model("pretrained")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from parking_exp.config.compose import compose
    from parking_exp.evaluation.agents import load_model
    from parking_exp.results import load
    from parking_exp.sweeps.single_run import train

__version__ = "0.1.0"
__all__ = ["compose", "load", "load_model", "train"]

_HOMES = {
    "compose": "parking_exp.config.compose",
    "load": "parking_exp.results",
    "load_model": "parking_exp.evaluation.agents",
    "train": "parking_exp.sweeps.single_run",
}


def __getattr__(name: str) -> Any:
    """Import a function when it is first asked for: torch and pandas take seconds."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
