"""Runs are found by directory, run id or `latest`; other names are refused with suggestions."""

import os

import pytest
from support.tracked_runs import finished_run

from parking_exp.errors import RunNotFoundError
from parking_exp.evaluation.agents import find_agent
from parking_exp.runs.lookup import find_run


@pytest.fixture
def output_dir(tmp_path):
    """An output directory with two runs: the one worked on last has no model yet."""
    for seed in (0, 1):
        run = tmp_path / "outputs" / "sweep" / "cell" / f"seed={seed}"
        (run / "models").mkdir(parents=True)
        (run / "status.json").write_text("{}")
        os.utime(run / "status.json", (seed, seed))
    (run.with_name("seed=0") / "models" / "final.zip").touch()
    return tmp_path / "outputs"


def refusal(name, output_dir):
    with pytest.raises(RunNotFoundError) as refused:
        find_agent(name, output_dir)
    return str(refused.value)


def test_a_run_is_found_by_its_directory(output_dir):
    path = output_dir / "sweep" / "cell" / "seed=1"
    assert find_run(str(path), output_dir, "x", other_names=()).path == path


def test_latest_is_the_run_whose_model_was_written_last_even_if_another_was_synced_since(
    output_dir,
):
    runs = [output_dir / "sweep" / "cell" / f"seed={seed}" for seed in (0, 1)]
    for seconds, run in enumerate(runs):
        (run / "models" / "final.zip").touch()
        os.utime(run / "models" / "final.zip", (seconds, seconds))
    os.utime(runs[0] / "status.json")
    assert find_run("latest", output_dir, "models/final.zip", other_names=()).path == runs[1]


def test_an_unknown_name_is_refused_with_suggestions(output_dir):
    latest = output_dir / "sweep" / "cell" / "seed=0"
    assert find_run("latest", output_dir, "models/final.zip", other_names=()).path == latest
    assert refusal("nothing", output_dir) == (
        f"run=nothing: there is no such run directory or MLflow run id; {output_dir} has 2 runs, "
        "1 with models/final.zip; "
        "write run=latest"
    )
    (latest / "models" / "final.zip").unlink()
    for name in ("nothing", "latest"):
        assert refusal(name, output_dir) == (
            f"run={name}: there is no such run directory or MLflow run id; {output_dir} has "
            "2 runs, 0 with models/final.zip; write run=pretrained"
        )
    assert f"{output_dir / 'empty'} has 0 runs, " in refusal("latest", output_dir / "empty")


@pytest.mark.parametrize(
    ("name", "meant"), [("default", "pretrained/default"), ("lates", "latest")]
)
def test_the_name_of_an_agent_or_of_the_latest_run_is_suggested(name, meant, output_dir):
    assert refusal(name, output_dir).endswith(f"did you mean {meant!r}?")


def test_the_run_that_latest_chose_is_named(tmp_path, capsys):
    directory = finished_run(tmp_path, seed=3)
    directory.update_status(label="n_sampled_goal=8")
    directory.models.mkdir()
    (directory.models / "final.zip").touch()
    assert find_agent("latest", tmp_path).folder == directory.path
    assert capsys.readouterr().out == "run=latest     n_sampled_goal=8 seed=3 of experiment=smoke\n"
