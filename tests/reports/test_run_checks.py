"""Numbers of runs that can't be right, or do not fit together: a sentence each, by name."""

from dataclasses import replace

import numpy as np
import pytest
from support.result_frames import Run, results

from parking_exp.reports.report_builder import build_report

SAC = {"sac": {}}
LABEL = "“sac, her_future”"


def warnings_of(frames):
    return build_report(frames, ["one"]).warnings[1:]  # the first is of few seeds


def of_seeds(*runs):
    return results(SAC, range(len(runs)), lambda label, seed: runs[seed])


def test_runs_that_fit_together_have_no_warning():
    assert warnings_of(of_seeds(Run(), Run(success=0.6), Run(success=1.0))) == []


@pytest.mark.parametrize("column", ["success_rate", "crash_rate", "timeout_rate"])
def test_a_stored_rate_that_contradicts_the_outcomes_is_named(column):
    frames = of_seeds(Run(), Run(success=0.6, columns={column: 0.8}), Run())
    assert warnings_of(frames) == [
        f"{LABEL}: stored rates contradict the outcomes of the episodes of seed 1."
    ]


def test_a_number_of_episodes_that_is_not_known_is_no_problem():
    frames = of_seeds(Run(), Run(success=0.6))
    unknown = frames.runs.drop(columns="config.evaluation.final_n_scenes")
    assert warnings_of(replace(frames, runs=unknown)) == []


def test_outcomes_that_are_missing_of_some_runs_are_named():
    frames = of_seeds(Run(), Run(), Run(), Run())
    is_kept = ~frames.episodes["run_id"].isin(["one-sac-1", "one-sac-3"])
    expected = (
        f"{LABEL}: some or all outcomes are missing for seeds 1, 3. "
        "Tables and figures of outcomes leave these runs out."
    )
    assert warnings_of(replace(frames, episodes=frames.episodes[is_kept])) == [expected]
    # two of the five episodes of a run
    of_run = frames.episodes[frames.episodes["run_id"] == "one-sac-3"].index
    halved = frames.episodes.drop(index=of_run[:2])
    of_one = expected.replace("seeds 1, 3", "seed 3")
    assert of_one in warnings_of(replace(frames, episodes=halved))
    none = frames.episodes[:0]
    assert warnings_of(replace(frames, episodes=none)) == []  # rates and nothing else
    of_each = frames.episodes.groupby("run_id").head(3)
    of_all = expected.replace("seeds 1, 3", "seeds 0, 1, 2, 3")
    assert of_all in warnings_of(replace(frames, episodes=of_each))


@pytest.mark.parametrize("curve", [(), (0.2, np.nan, 0.6, 0.8), (0.2, 0.4)])
def test_curves_that_are_missing_or_have_gaps_are_named(curve):
    expected = (
        f"{LABEL}: evaluations during training have gaps, or are fewer than those of other seeds, "
        "for seed 0. AUC and times use those that there are."
    )
    if curve:
        assert warnings_of(of_seeds(Run(curve=curve), Run(), Run())) == [expected]
    else:
        frames = of_seeds(Run(), Run(), Run())
        others = frames.curves[frames.curves["run_id"] != "one-sac-0"]
        assert warnings_of(replace(frames, curves=others)) == [expected]


def test_a_rate_outside_0_to_1_is_left_out_with_a_sentence():
    frames = of_seeds(Run(columns={"success_rate": 1.7}), Run(), Run(curve=(0.2, -0.5, 0.6, 0.8)))
    report = build_report(frames, ["one"])
    assert report.cells[0].success.n == 2
    assert "parking-sac seed=0: success_rate 1.7 is not a rate, and is left out." in report.warnings
    assert (
        "parking-sac seed=2: success_rate -0.5 is not a rate, and is left out." in report.warnings
    )
    assert report.cells[0].curve.low == [0.2, 0.4, 0.6, 0.8]


def test_keys_of_the_config_are_no_rates():
    frames = of_seeds(Run(), Run())
    runs = frames.runs.assign(**{"config.env.kwargs.frame_rate": 15.0})
    assert warnings_of(replace(frames, runs=runs)) == []


def test_cells_that_never_succeed_have_no_highest():
    cells = {"sac": {}, "td3": {"algorithm.name": "td3"}}
    report = build_report(results(cells, range(4), lambda *_: Run(success=0.0)), ["one"])
    assert report.claims[0] == "No cell succeeds in any episode."
