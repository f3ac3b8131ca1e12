"""The script that evaluates agents on perturbed tasks."""

import sys

import pytest
from support.runs import import_script

from parking_exp import compose, load_model
from parking_exp.algorithms.build_model import GreedyPolicy


@pytest.fixture
def script():
    return import_script("robustness")


@pytest.mark.slow
def test_noise_is_tolerated_and_delay_is_not(script, monkeypatch):
    monkeypatch.setattr(script, "N_SCENES", 50)
    policy, env = GreedyPolicy(load_model("pretrained")), compose("env=parking").env
    assert script.evaluate(policy, env, script.Perturbation(noise=0.1)) == {
        "success": 1,
        "crash": 0,
        "parked": 0,
    }
    assert script.evaluate(policy, env, script.Perturbation(delay=2))["success"] < 0.5


def test_arguments_name_the_agents_and_what_success_requires_names_the_metric(
    script, monkeypatch, capsys
):
    monkeypatch.setattr(script, "N_SCENES", 4)
    monkeypatch.setattr(script, "PERTURBATIONS", {"none": script.Perturbation()})
    monkeypatch.setattr(sys, "argv", ["robustness.py", "pretrained", "pretrained/parked"])
    script.main()
    assert capsys.readouterr().out.splitlines() == [
        "| perturbation | `pretrained`: success (crash) | `parked`: parked (crash) |",
        "|---|---:|---:|",
        "| none | 100.0 (0.0) | 100.0 (0.0) |",
    ]


def test_a_run_that_there_is_not_is_one_sentence(script, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["robustness.py", "run=nothing"])
    with pytest.raises(SystemExit, match="2"):
        script.main()
    assert capsys.readouterr().err.startswith("error: run=nothing: there is no such run ")


def test_rates_of_several_agents_are_averaged(script, monkeypatch):
    shares = iter([{"success": 1.0, "crash": 0.0}, {"success": 0.5, "crash": 0.25}])
    monkeypatch.setattr(script, "evaluate", lambda *_: next(shares))
    column = script.Column("pretrained")
    column.agents *= 2
    assert column.rates(script.Perturbation()) == "75.0, 50.0 to 100.0 (12.5)"
