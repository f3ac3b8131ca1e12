"""scripts/benchmark.py measures what it is asked for, and keeps what it has measured."""

import importlib.util
import json

import pytest
from support.runs import run_script


@pytest.mark.slow
def test_the_benchmark_measures_and_writes(tmp_path):
    done = run_script(
        "benchmark",
        "--quick",
        "only=[simulator,update.ddpg.2x64,run.tutorial,her,sweep.overhead,sweep.resume]",
        f"output_dir={tmp_path}",
    )
    assert done.returncode == 0, done.stderr
    written = json.loads((tmp_path / "benchmark.json").read_text())
    assert sorted(written) == sorted([
        "simulator.n512.ratio", "simulator.n8.ratio", "simulator.parked.n512.ratio", "update.ddpg.2x64.ratio",
        "run.tutorial.ratio", "her.sample.capacity_ratio", "her.sample.ratio", "her.bytes_per_transition", "her.save.bytes_per_transition",
        "sweep.overhead_s_per_run", "sweep.resume_scan_s.1000_runs",
    ])  # fmt: skip
    for key, entry in written.items():
        unit = "bytes" if "bytes" in key else "seconds" if "_s" in key.split(".")[1] else "ratio"
        assert entry["about"]["quick"] is True
        assert entry["rounds"] == (1 if unit == "bytes" or key == "sweep.overhead_s_per_run" else 2)
        assert entry["lowest"] <= entry[unit] <= entry["highest"]
        (line,) = [line for line in done.stdout.splitlines() if line.startswith(key)]
        assert f"{entry[unit]:.4g}" in line
    assert 112 < written["her.bytes_per_transition"]["bytes"] < 120
    assert 112 < written["her.save.bytes_per_transition"]["bytes"] < 120


def quick_update_against_sbx(tmp_path):
    key = "update.td3.2x64.n1.sbx.ratio"
    done = run_script("benchmark", "--quick", f"only=[{key}]", f"output_dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    return json.loads((tmp_path / "benchmark.json").read_text())[key]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("sbx") is None, reason="needs the extra: pip install 'parking-exp[bench]'")
def test_updates_are_compared_with_sbx(tmp_path):
    entry = quick_update_against_sbx(tmp_path)
    assert entry["peer"] == "sbx, with our replay buffer"
    assert 0 < entry["lowest"] <= entry["ratio"] <= entry["highest"]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("sbx") is not None, reason="sbx is installed")
def test_without_sbx_its_figures_are_missing(tmp_path):
    assert quick_update_against_sbx(tmp_path)["missing"] == "sbx not installed"


@pytest.mark.slow
def test_what_an_agent_costs_is_compared_with_the_tutorials_which_is_measured_once(tmp_path):
    arguments = ("--quick", "only=[run.to_95,run.whole]", f"output_dir={tmp_path}")
    done = run_script("benchmark", *arguments)
    assert done.returncode == 0, done.stderr
    written = json.loads((tmp_path / "benchmark.json").read_text())
    assert sorted(written) == ["run.to_95.ratio", "run.whole.ratio"]
    kept = tmp_path / "benchmark_peer_quick.json"
    (peer,) = json.loads(kept.read_text()).values()
    (seed,) = peer["seeds"].values()
    # After 900 steps 95 % are not held: what it took is less than it would take.
    assert (seed["reached"], seed["steps"]) == (False, [300, 600, 900])
    assert max(seed["success"]) < 0.5
    assert seed["cost_s"] == seed["cpu_s"][-1] > 0
    ours = written["run.to_95.ratio"]
    assert ours["peer_cpu_s"] == [seed["cost_s"]]
    assert (ours["ratio"], ours["ours_cpu_s"]) == (0.0, [None])  # neither does our short run
    whole = written["run.whole.ratio"]
    assert whole["ratio"] == pytest.approx(seed["cost_s"] / whole["ours_cpu_s"][0], rel=1e-3)
    assert whole["ours_success_rate"] == [0.0]
    before = kept.stat().st_mtime_ns
    assert run_script("benchmark", *arguments).returncode == 0
    assert kept.stat().st_mtime_ns == before


@pytest.mark.parametrize(
    ("argument", "named"),
    [("only=[simulater]", "only=simulater"), ("core=999", "core=999"), ("rounds=0", "rounds=0"), ("round=1", "round")],
)
def test_a_benchmark_that_cannot_be_is_refused(argument, named, tmp_path):
    done = run_script("benchmark", argument, cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: ") and named in done.stderr and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
