"""Metrics of a user's own package, named in `env.metrics`: from an episode to a report."""

import shutil
import sys

import pandas as pd
import pytest
from support.report_command import report
from support.runs import call_script, config_refusal, only_run
from support.toy_tasks import BITS
from support.user_policies import constant

from parking_exp.config.compose import compose
from parking_exp.errors import UntrustedError
from parking_exp.evaluation.agents import load_model
from parking_exp.evaluation.evaluate_policy import evaluate_policy
from parking_exp.results import load, read_export
from parking_exp.sweeps.single_run import train
from parking_exp.tasks.custom_config import CustomConfig
from parking_exp.tasks.registry import make_task

OWN = "support.user_metrics"
BOTH = f"env.metrics=[{OWN}.centred,{OWN}.last_speed]"


def test_a_metric_of_parking_has_the_pose_at_the_end_and_the_same_info_in_both_simulators():
    metrics = f"env.metrics=[{OWN}.centred,{OWN}.ended,{OWN}.last_speed]"
    task = make_task(compose("env.duration=6", metrics).env)

    tables = []
    for simulator in ("vectorized", "highway_env"):
        tables.append(evaluate_policy(constant(1.0, 0.0), task, range(8), simulator=simulator))

    assert list(tables[0].columns[-3:]) == ["centred", "ended", "last_speed"]
    assert tables[0]["centred"].tolist() == (tables[0]["distance_m"] < 0.5).tolist()
    assert tables[0]["ended"].tolist() == (tables[0]["outcome"] != "timeout").tolist()
    assert tables[0]["last_speed"].abs().tolist() == tables[0]["speed_mps"].tolist()
    pd.testing.assert_frame_equal(tables[0], tables[1], rtol=1e-9)


def test_a_metric_of_a_goal_environment_has_its_last_info():
    options = ["env=gymnasium", "env.id=support.toy_tasks:BitFlip-v0"]
    metric = f"env.metrics=[{OWN}.was_lost]"
    task = make_task(compose(*options, "algorithm.learning_starts=400", metric).env)

    table = evaluate_policy(constant(*range(BITS)), task, range(4))

    assert table.columns[-1] == "was_lost"
    assert table["was_lost"].tolist() == [False] * 4


def test_a_metric_of_a_task_of_arrays_has_its_state_at_the_end():
    config = CustomConfig(
        task="support.user_tasks.Steps", name="steps", metrics=[f"{OWN}.position"]
    )

    table = evaluate_policy(constant(1.0), make_task(config), [0, 2])

    assert table["position"].tolist() == [3.0, 3.0]


@pytest.mark.parametrize(
    ("paths", "problem"),
    [
        ("no_such.centred", "0=no_such.centred: ModuleNotFoundError: No module named 'no_such'"),
        (
            f"{OWN}.centred,{OWN}.centered",
            f"1={OWN}.centered: AttributeError: module '{OWN}' has no attribute 'centered'",
        ),
        ("math.pi", "0=math.pi is not a parking_exp.tasks.metrics.Metric"),
        (
            f"{OWN}.second_success",
            f"0={OWN}.second_success: there is a metric or column success already",
        ),
        (
            f"{OWN}.centred,{OWN}.centred",
            f"1={OWN}.centred: there is a metric or column centred already",
        ),
        (f"{OWN}.spaced", f"0={OWN}.spaced: its name 'two words' is not an identifier"),
    ],
)
def test_what_is_no_new_metric_is_one_sentence(paths, problem):
    assert config_refusal(f"env.metrics=[{paths}]") == f"env.metrics.{problem}"


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """The output directory of a run with two metrics."""
    output_dir = tmp_path_factory.mktemp("own")
    train(compose("experiment=smoke", f"output_dir={output_dir}", BOTH))
    return output_dir


@pytest.fixture
def without_module(trained, monkeypatch):
    """The output directory, where the module of the metrics can't be imported."""
    monkeypatch.setitem(sys.modules, OWN, None)
    return trained


def test_results_have_a_users_metrics_without_importing_them(without_module):
    directory = only_run(without_module)
    results = load("smoke", output_dir=without_module)

    episodes = pd.read_csv(directory.path / "episodes.csv")
    final = episodes[episodes["phase"] == "final"]
    (run,) = results.runs.to_dict("records")
    assert run["centred_rate"] == final["centred"].mean()
    assert run["last_speed_mean"] == final["last_speed"].mean()
    metrics = directory.read_result().metrics
    assert metrics["final/last_speed_mean"] == metrics["certified/last_speed_mean"]

    of_evaluations = episodes[episodes["phase"] == "eval"].groupby("step")["last_speed"].mean()
    curve = results.curves.set_index("step")["last_speed_mean"]
    assert curve.to_dict() == pytest.approx(of_evaluations.to_dict())
    assert results.episodes["centred"].tolist() == episodes["centred"].tolist()
    assert str(results.episodes["centred"].dtype) == "bool"


def test_a_report_and_an_export_have_a_users_metrics_without_importing_them(
    without_module, tmp_path
):
    speed = load("smoke", output_dir=without_module).runs["last_speed_mean"].item()
    report(without_module, "experiment=smoke", f"export={tmp_path}/export")

    folder = without_module / "reports" / "smoke"
    page = (folder / "index.html").read_text()
    assert "centred (%)" in page
    headline = pd.read_csv(folder / "tables" / "headline.csv")
    assert headline["last_speed_mean"].item() == pytest.approx(speed)
    exported = read_export(tmp_path / "export")
    assert exported.runs["last_speed_mean"].item() == pytest.approx(speed, rel=1e-5)
    assert len(exported.curves["centred_rate"].dropna()) == 4


def test_a_metric_is_part_of_a_runs_key_and_added_to_a_trained_run_by_an_evaluation(
    smoke, tmp_path
):
    plain = compose("experiment=smoke")
    assert compose("experiment=smoke", BOTH).run_key != plain.run_key
    assert compose("experiment=smoke", "env.metrics=null").run_key == plain.run_key
    assert "metrics" not in plain.plain()["env"]

    path = tmp_path / "smoke" / "cell" / "seed=0"
    shutil.copytree(smoke.path, path)
    arguments = ("episodes=3", "simulator=highway_env", "tracking.mlflow=false")
    metric = f"env.metrics=[{OWN}.last_speed]"
    done = call_script("evaluate", f"run={path}", metric, *arguments, code=0)
    assert "final model on 3 episodes of parking, from seed 0" in done.stdout  # the same episodes
    table = pd.read_csv(path / "evaluations" / "parking-final-seeds-0-2" / "episodes.csv")
    assert table["last_speed"].abs().tolist() == table["speed_mps"].tolist()


def test_metrics_of_a_run_from_elsewhere_are_not_executed(trained, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))  # which has no record of the training
    with pytest.raises(UntrustedError, match=f"env.metrics.0={OWN}.centred in .* allow-list"):
        load_model(str(only_run(trained).path))
