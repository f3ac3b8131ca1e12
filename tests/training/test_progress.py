"""The progress bar, lines and heartbeat of a training."""

import io
import re
import time

import pytest
from rich.console import Console
from rich.text import Text

from parking_exp.training.progress import TrainingProgress


def drawn(width, total, draw):
    """All different lines that a bar draws on a terminal of some width."""
    console = Console(width=width, force_terminal=True, file=io.StringIO())
    with TrainingProgress(total, 0, True, console) as bar:
        time.sleep(0.25)
        draw(bar)
        time.sleep(0.25)  # it is drawn ten times a second
    return {line for part in re.split("[\r\n]", console.file.getvalue()) if (line := Text.from_ansi(part).plain)}


@pytest.mark.parametrize("total", [60_000, 10_000_000])
def test_on_eighty_columns_both_times_are_whole(total):
    lines = drawn(80, total, lambda bar: bar.update(total // 2, 0.94, -12.3))
    lines |= drawn(80, total, lambda bar: bar.busy("certification on highway-env"))
    assert len([line for line in lines if line.startswith("certification on highway-env ━")]) == 1
    assert len([line for line in lines if f" {total // 2}/{total} success  94%  " in line]) >= (total == 60_000)
    for line in lines:
        assert re.search(r" \d:\d\d:\d\d (\d|-):(\d\d|--):(\d\d|--)$", line), line
        assert len(line) <= 80


@pytest.mark.parametrize(
    ("width", "figures"),
    [
        (120, r"success  94%  return  -12.3  \d+ steps/s"),
        (80, r"success  94%  \d+ steps/s"),
        (66, r"\d+ steps/s"),
        (50, ""),
    ],
)
def test_figures_leave_out_what_there_is_no_room_for(width, figures):
    lines = drawn(width, 60_000, lambda bar: bar.update(30_000, 0.94, -12.3))
    assert any(re.search(rf"━ 30000/60000 {figures} 0:00:0\d ", line) for line in lines), lines
