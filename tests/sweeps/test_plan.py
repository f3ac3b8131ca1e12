"""Plans of sweeps: labels of cells, what is due, and duration estimates from finished runs."""

from support.runs import call_script, make_config
from support.sweep_processes import QUICK

from parking_exp.config.compose import composed_runs
from parking_exp.runs.directory import RunDirectory, RunResult
from parking_exp.sweeps.sweep import duration_estimate, plan


def finish(output_dir, wall_s, *overrides):
    """Write the directory of a finished run."""
    config = make_config(*overrides, f"output_dir={output_dir}")
    directory = RunDirectory(config.run_dir)
    directory.create(config)
    directory.finish(RunResult(str(directory.path), None, config.total_timesteps, {}), wall_s=wall_s)


def test_a_dry_run_prints_the_plan_and_makes_nothing(tmp_path):
    arguments = (*QUICK, f"output_dir={tmp_path / 'outputs'}", "seeds=3", "buffer=her_future,her_final")
    done = call_script("train", *arguments, "dry_run=true", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[:3] == [
        ["cell", "done", "running", "failed", "pending", "success"], ["her_future", "3"], ["her_final", "3"]
    ]  # fmt: skip
    assert "2 cells x 3 seeds = 6 runs: 0 done, 6 to run; no run has finished yet" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_labels_of_a_sweep_are_what_differs_between_its_cells(tmp_path):
    axes = ["buffer.n_sampled_goal=2,4", "algorithm.gamma=0.9", "buffer.goal_selection_strategy=final,future"]
    runs = plan(composed_runs("config", [*QUICK, "buffer=her_final", *axes, f"output_dir={tmp_path}"]))
    assert [run.label for run in runs] == [
        f"goal_selection_strategy={strategy}, n_sampled_goal={number}"
        for number in (2, 4)
        for strategy in ("final", "future")
    ]


def test_a_run_is_timed_by_its_cell_else_by_the_other_cells_of_the_sweep(tmp_path):
    composed = composed_runs(
        "config", ["experiment=smoke", "algorithm.gamma=0.9,0.95", "seeds=2", f"output_dir={tmp_path}"]
    )

    def estimate(n_jobs):
        runs = plan(composed)
        return duration_estimate([run.state for run in runs], [run for run in runs if run.is_due], n_jobs)

    finish(tmp_path, 99, "experiment=smoke", "experiment_name=another", "algorithm.gamma=0.8")
    assert estimate(1).startswith("; no run has finished yet")
    finish(tmp_path, 20, "experiment=smoke", "algorithm.gamma=0.9")
    assert estimate(1) == ", about 60 s"
    finish(tmp_path, 30, "experiment=smoke", "algorithm.gamma=0.95")
    assert estimate(1) == ", about 50 s"
    assert estimate(2) == estimate(8).replace("8", "2") == ", about 25 s with 2 at a time"
