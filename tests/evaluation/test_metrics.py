"""A metric is declared once; tests/docs shows that an entry of METRICS is in the results of the next evaluation."""

import pandas as pd

from parking_exp.runs.metric_logs import append_episodes


def test_a_run_that_began_before_a_metric_was_added_keeps_the_columns_of_its_table(tmp_path):
    path = tmp_path / "episodes.csv"
    append_episodes(path, pd.DataFrame({"scene": [3], "steps": [7]}), "eval", 100)
    append_episodes(path, pd.DataFrame({"scene": [4], "side_m": [0.5], "steps": [9]}), "eval", 200)
    assert path.read_text() == "phase,step,scene,steps\neval,100,3,7\neval,200,4,9\n"
