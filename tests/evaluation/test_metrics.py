"""A metric is declared once."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from parking_exp.evaluation.metrics import METRICS, RANKING
from parking_exp.runs.metric_logs import append_episodes

ROOT = Path(__file__).resolve().parents[2]

# What one adds to METRICS,
ENTRY = """
    Metric(
        name="side_m",
        of=lambda episode: abs(episode.end.side_m),
        label="Offset to the side",
        unit="m",
        higher_is_better=False,
        in_curves=True,
        in_reports=True,
    ),
"""
# and a look at every place where it then is.
EXAMPLE = """
import json, sys, types
from pathlib import Path

import parking_exp.evaluation

path, entry = Path(parking_exp.evaluation.__file__).with_name("metrics.py"), sys.argv[2]
source = path.read_text().replace(")\\n\\nRANKING", entry.strip("\\n") + "\\n)\\n\\nRANKING")
metrics = types.ModuleType("parking_exp.evaluation.metrics")
parking_exp.evaluation.metrics = sys.modules[metrics.__name__] = metrics
exec(compile(source, path, "exec"), metrics.__dict__)

import numpy as np
from support.store_factory import compose, make_store
from parking_exp.evaluation.evaluate_policy import evaluate, summarise
from parking_exp.evaluation.description import describe
from parking_exp.reports.build import Question, build
from parking_exp.reports.render.files import write_tables
from parking_exp.results import load
from parking_exp.runs.metric_logs import append_episodes
from parking_exp.tracking.reader import Reader

folder = Path(sys.argv[1])
env = compose("env.duration=2").env
episodes = evaluate(lambda seen: np.zeros((len(seen["observation"]), 2)), env, [3, 8])
append_episodes(folder / "episodes.csv", episodes, "eval", 0)
make_store(folder, "one", {"sac": [], "td3": ["algorithm=td3"]}, range(2), bulk=True)
results = load("one", output_dir=folder)
report = build(results, Question(["one"]))
write_tables(report, folder)
(experiment,) = [one for name, one in Reader(results.uri).experiments().items() if name == "one"]
print(json.dumps({
    "csv": (folder / "episodes.csv").read_text().splitlines()[0],
    "side": float(episodes["side_m"].min()),
    "summary": sorted(summarise(episodes)),
    "words": describe(episodes).splitlines()[-1],
    "store": sorted(Reader(results.uri).runs([experiment])[0].metrics),
    "runs": float(results.runs["side_m"].max()),
    "curves": str(results.curves["side_m_mean"].dtype),
    "episodes": str(results.episodes["side_m"].dtype),
    "mean": report.cells[0].further["side_m"].value,
    "seed": report.plain()["cells"][0]["seeds"][0]["side_m"],
    "headline": (folder / "headline.csv").read_text().splitlines()[0],
    "seeds": (folder / "seeds.csv").read_text().splitlines()[0],
    "latex": (folder / "headline.tex").read_text(),
}))
"""


@pytest.mark.slow
def test_a_metric_that_is_declared_is_in_episodes_summaries_store_frames_and_reports(output_dir):
    command = [sys.executable, "-c", EXAMPLE, str(output_dir), ENTRY]
    path = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "PATH": "/usr/bin:/bin"}
    done = subprocess.run(command, cwd=ROOT, env=path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["csv"].endswith(",speed_mps,side_m")
    assert found["side"] > 0
    assert "side_m_mean" in found["summary"]
    assert re.search(r", offset to the side [\d.]+ m$", found["words"])
    assert {"eval/side_m_mean", "final/side_m_mean", "certified/side_m_mean"} <= set(found["store"])
    assert 0 < found["runs"] < 1
    assert (found["curves"], found["episodes"]) == ("float64", "float64")
    assert 0 < found["mean"] < 1
    assert 0 < found["seed"] < 1
    assert "side_m,side_m_low,side_m_high" in found["headline"]
    assert found["seeds"].endswith(",side_m")
    assert "Offset to the side (m)" in found["latex"]


def test_a_run_that_began_before_a_metric_was_added_keeps_the_columns_of_its_table(tmp_path):
    path = tmp_path / "episodes.csv"
    append_episodes(path, pd.DataFrame({"scene": [3], "steps": [7]}), "eval", 100)
    append_episodes(path, pd.DataFrame({"scene": [4], "side_m": [0.5], "steps": [9]}), "eval", 200)
    assert path.read_text() == "phase,step,scene,steps\neval,100,3,7\neval,200,4,9\n"


def test_names_are_unique_and_the_ranking_knows_what_is_better():
    names = [metric.name for metric in METRICS]
    assert len({*names}) == len(names)
    assert len({metric.run_column for metric in METRICS}) == len(names)
    ranked = [metric for metric in METRICS if metric.name in RANKING]
    assert [metric.higher_is_better for metric in ranked] == [True, False, False]
