"""The command evaluate.py: what it prints."""

from support.runs import type_here

from parking_exp.config.compose import composed
from parking_exp.evaluation import evaluate_run

SHORT = ("run=pretrained", "episodes=2", "simulator=vectorized", "env=parking", "env.duration=0.4", "name=short")


def test_without_a_terminal_there_are_lines_of_text_alone_and_the_video_and_gif_are_named(tmp_path):
    done = type_here("evaluate", *SHORT, "video=1", "gif=true", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert "" not in lines
    folder = tmp_path / "outputs" / "pretrained" / "default" / "evaluations" / "short"
    assert lines[-3:] == [
        f"video          {folder}/video.gif",
        f"video          {folder}/video.mp4",
        f"results        {folder}",
    ]
    assert {path.name for path in folder.iterdir()} == {"episodes.csv", "summary.json", "video.gif", "video.mp4"}


def test_without_a_terminal_progress_is_a_line_every_few_seconds(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(evaluate_run, "LINE_EVERY_S", 0.0)
    monkeypatch.chdir(tmp_path)
    evaluate_run.evaluate_run(composed("evaluate", list(SHORT))[0])
    # Two steps of two episodes.
    assert capsys.readouterr().err == "2 episodes of parking: 2 of 2 done\n"


def test_no_video_is_named_where_none_is_asked_for(tmp_path):
    for video in ("video=1", "video=0"):
        done = type_here("evaluate", *SHORT, video, cwd=tmp_path)
    assert done.returncode == 0
    assert [line for line in done.stdout.splitlines() if line.startswith("video")] == []
