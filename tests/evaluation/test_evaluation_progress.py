"""The progress of an evaluation is shown on the standard error stream."""

from support.runs import call_script

from parking_exp.evaluation import evaluation_progress
from parking_exp.evaluation.evaluation_progress import EvaluationProgress


def lines(finished, capsys):
    with EvaluationProgress(500, "parking") as progress:
        for number in finished:
            progress.update(number)
    return capsys.readouterr().err.splitlines()


def test_without_a_terminal_there_is_a_line_for_each_tenth_of_the_episodes(monkeypatch, capsys):
    monkeypatch.setattr(evaluation_progress, "QUIET_S", 0.0)
    shown = lines(range(1, 501), capsys)
    tenths = [
        f"evaluation  {number} of 500 episodes of parking over, after 0 s"
        for number in range(50, 501, 50)
    ]
    assert [line for line in shown if line in tenths] == tenths


def test_while_no_episode_is_over_lines_come_at_growing_intervals(monkeypatch, capsys):
    seconds = iter(range(1000))
    monkeypatch.setattr(evaluation_progress.time, "monotonic", lambda: next(seconds))
    shown = lines([0] * 90, capsys)
    assert shown == [
        f"evaluation  0 of 500 episodes of parking over, after {s} s" for s in (5, 10, 20, 40, 80)
    ]


def test_a_short_evaluation_prints_no_progress(tmp_path):
    done = call_script(
        "evaluate", "run=pretrained", "episodes=2", "simulator=vectorized", cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (0, "")
