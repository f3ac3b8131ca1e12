"""scripts/benchmark.py measures the chosen figures, and keeps those of earlier calls."""

import json

import pytest
from support.runs import run_script


def benchmark(folder, *figures):
    done = run_script(
        "benchmark",
        "--quick",
        f"only=[{','.join(figures)}]",
        f"output_dir={folder}",
        timeout=600,
        code=0,
    )
    return json.loads((folder / "benchmark.json").read_text()), done.stdout


@pytest.mark.slow
def test_chosen_figures_are_measured_printed_and_added_to_the_file(tmp_path):
    first, _ = benchmark(tmp_path, "simulator.n8.ratio")
    assert list(first) == ["simulator.n8.ratio"]
    figures, printed = benchmark(
        tmp_path,
        "decision",
        "simulator.crowded",
        "update.ddpg.2x64",
        "run.tutorial",
        "her",
        "sweep.overhead",
        "sweep.resume",
    )
    assert sorted(figures) == [
        "decision.agent.ms",
        "decision.planner.ms",
        "her.bytes_per_transition",
        "her.sample.capacity_ratio",
        "her.sample.ratio",
        "run.tutorial.ratio",
        "simulator.crowded.8_seen.n512.ratio",
        "simulator.crowded.n512.ratio",
        "simulator.n8.ratio",
        "sweep.overhead_s_per_run",
        "sweep.resume_scan_s.1000_runs",
        "update.ddpg.2x64.ratio",
    ]
    assert figures["simulator.n8.ratio"] == first["simulator.n8.ratio"]
    for key, entry in figures.items():
        value = entry["value"]
        assert 0 < entry["lowest"] <= value <= entry["highest"]
        assert key in first or f"{value:.4g}" in printed
    assert 112 < figures["her.bytes_per_transition"]["value"] < 120


@pytest.mark.parametrize("argument", ["only=[simulater]", "core=999", "rounds=0", "round=1"])
def test_a_wrong_argument_is_named(argument, tmp_path):
    done = run_script("benchmark", argument, cwd=tmp_path, code=1)
    assert done.stderr.startswith("error: ") and argument.partition("=")[0] in done.stderr
    assert list(tmp_path.iterdir()) == []
