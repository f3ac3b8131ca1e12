"""Find stored numbers of runs that can't be right, or that do not fit together."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.phrases import quoted_label
from parking_exp.reports.cell_selection import CellRuns
from parking_exp.reports.cell_summaries import FINAL_EPISODES, RunEvaluations
from parking_exp.results.frames import Results
from parking_exp.statistics import finite_or_none
from parking_exp.tasks.registry import OUTCOMES


def leave_out_impossible_rates(results: Results) -> Results:
    """Return results without rates outside 0 ... 1; `problems` has a sentence for each."""
    problems = list(results.problems)
    runs = results.runs.set_index("run_id")
    names = runs["cell"] + " seed=" + runs["seed"].astype(str)
    return replace(
        results,
        runs=_leave_out_impossible(results.runs, names, problems),
        curves=_leave_out_impossible(results.curves, names, problems),
        problems=tuple(problems),
    )


def _leave_out_impossible(
    frame: pd.DataFrame, names: pd.Series, problems: list[str]
) -> pd.DataFrame:
    """Return a frame with a column `run_id` without impossible rates.

    `problems` gets a sentence for each run and rate; `names` has the names of runs by their id.
    """
    kept = frame.copy()
    # Keys of the config, such as `learning_rate`, are not metrics.
    for column in frame.filter(regex=r"^(?!config\.).*_rate$"):
        is_impossible = (frame[column] < 0) | (frame[column] > 1)
        for run in frame[is_impossible].drop_duplicates("run_id").to_dict("records"):
            name = names[run["run_id"]]
            problems.append(f"{name}: {column} {run[column]:g} is not a rate, and is left out.")
        kept.loc[is_impossible, column] = np.nan
    return kept


def find_contradictions(cells: Sequence[CellRuns], evaluations: RunEvaluations) -> Iterator[str]:
    """Yield which runs lack outcomes or evaluations, and whose outcomes contradict their rate."""
    for cell in cells:
        longest_curve = evaluations.n_evaluations.reindex(cell.done["run_id"]).max()
        contradicting = []
        without_outcomes = []
        without_curves = []
        for run in cell.done.to_dict("records"):
            seed = run["seed"]
            episodes = evaluations.final.get(run["run_id"])
            n_expected = finite_or_none(run.get(FINAL_EPISODES)) or 0
            if episodes is None or len(episodes) < n_expected:
                without_outcomes.append(seed)
            elif _contradict(run, episodes["outcome"]):
                contradicting.append(seed)
            if len(evaluations.curves.get(run["run_id"], ())) < longest_curve:
                without_curves.append(seed)

        label = quoted_label(cell.label)
        if contradicting:
            yield (
                f"{label}: stored rates contradict the outcomes of the episodes of "
                f"{_list_seeds(contradicting)}."
            )
        # Some results have rates and nothing else.
        if without_outcomes and evaluations.final:
            yield (
                f"{label}: some or all outcomes are missing for {_list_seeds(without_outcomes)}. "
                "Tables and figures of outcomes leave these runs out."
            )
        if without_curves:
            yield (
                f"{label}: evaluations during training have gaps, or are fewer than those of other "
                f"seeds, for {_list_seeds(without_curves)}. AUC and times use those that there are."
            )


def _contradict(run: Mapping[Any, Any], outcomes: pd.Series) -> bool:
    """Return whether a rate of a run is off by more than half an episode."""
    for outcome in OUTCOMES:
        rate = finite_or_none(run.get(f"{outcome}_rate"))
        share = (outcomes == outcome).mean()
        if rate is not None and abs(rate - share) > 0.5 / len(outcomes):
            return True
    return False


def _list_seeds(seeds: Sequence[int]) -> str:
    numbers = [str(seed) for seed in seeds]
    return f"seed {numbers[0]}" if len(numbers) == 1 else f"seeds {', '.join(numbers)}"
