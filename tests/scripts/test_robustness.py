"""The script that evaluates the pretrained agents on perturbed tasks."""

import importlib.util
import sys
from pathlib import Path

import pytest

from parking_exp import compose, load_model
from parking_exp.algorithms.build_model import greedy_policy

SCRIPT = Path(__file__).parents[2] / "scripts" / "robustness.py"


@pytest.mark.slow
def test_noise_is_tolerated_and_delay_is_not(monkeypatch):
    spec = importlib.util.spec_from_file_location("robustness", SCRIPT)
    script = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "robustness", script)
    spec.loader.exec_module(script)
    monkeypatch.setattr(script, "N_SCENES", 50)
    policy, env = greedy_policy(load_model("pretrained")), compose("env=parking").env
    assert script.evaluate(policy, env, script.Perturbation(noise=0.1)) == {
        "success": 1,
        "crash": 0,
        "parked": 0,
    }
    assert script.evaluate(policy, env, script.Perturbation(delay=2))["success"] < 0.5
