"""All that a model is made of, as values to compare bit for bit."""

import numpy as np
import torch

from parking_exp.algorithms.build_model import greedy_policy
from parking_exp.algorithms.model_files import reachable

BATCH = 32


def model_state(model):
    """As bytes: all tensors of a model, those of its optimizers, and its actions on the same random observations."""
    rng = np.random.default_rng(0)
    observations = {
        name: rng.standard_normal((BATCH, *box.shape)).astype(box.dtype)
        for name, box in model.observation_space.items()
    }
    found = {"the deterministic action": _exact(greedy_policy(model)(observations))}
    for name, one in reachable(model):
        if isinstance(one, torch.Tensor):
            found[name] = _exact(one)
        else:
            found |= {
                f"{name}.{number}.{key}": _exact(value)
                for number, values in one.state_dict()["state"].items()
                for key, value in values.items()
            }
    return found


def _exact(value):
    array = value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
    return array.dtype.str, array.shape, array.tobytes()
