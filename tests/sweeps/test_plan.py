"""Plans of sweeps: cells, and what is due."""

from support.runs import call_script
from support.sweep_processes import QUICK


def test_a_dry_run_prints_the_plan_and_makes_nothing(tmp_path):
    arguments = (
        *QUICK,
        f"output_dir={tmp_path / 'outputs'}",
        "seeds=3",
        "buffer=her_future,her_final",
    )
    done = call_script("train", *arguments, "dry_run=true", cwd=tmp_path, code=0)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert lines[:3] == [
        ["cell", "done", "running", "failed", "pending", "success"],
        ["her_future", "3"],
        ["her_final", "3"],
    ]
    assert "6 runs, 6 to run\n" in done.stdout
    assert list(tmp_path.iterdir()) == []
