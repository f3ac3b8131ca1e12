"""Tests of the progress that a run shows, and of its heartbeat."""

from parking_exp.training import progress_display
from parking_exp.training.progress_display import ProgressDisplay


def test_without_a_terminal_a_long_activity_has_a_line_now_and_then(monkeypatch, capsys):
    clock = Clock()
    monkeypatch.setattr(progress_display.time, "monotonic", clock)
    beats = []
    display = ProgressDisplay(100, 0, enabled=True, heartbeat=lambda **beat: beats.append(beat))
    display.show_activity("demonstrations")
    for n_finished in range(12):
        display.show_episodes(n_finished, 40)
        clock.now += 2
    display.close()
    assert capsys.readouterr().err.splitlines() == [
        "demonstrations  5 of 40 episodes done",
        "demonstrations  10 of 40 episodes done",
    ]
    assert [beat["doing"] for beat in beats[:3]] == [
        "demonstrations",
        "demonstrations, 1 of 40 episodes done",
        "demonstrations, 2 of 40 episodes done",
    ]


class Clock:
    """A clock that stands still."""

    now = 100.0

    def __call__(self):
        return self.now
