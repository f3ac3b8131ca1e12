"""The progress bar of a training."""

import io
import re
import time
from contextlib import closing

import pytest
from rich.console import Console
from rich.text import Text

from parking_exp.training.progress import TrainingProgress


def drawn(total, draw):
    """Return the different lines that a bar draws on a terminal of 80 columns."""
    console = Console(width=80, force_terminal=True, file=io.StringIO())
    with closing(TrainingProgress(total, 0, True, console)) as bar:
        time.sleep(0.25)
        draw(bar)
        time.sleep(0.25)  # it is drawn ten times a second
    return {line for part in re.split("[\r\n]", console.file.getvalue()) if (line := Text.from_ansi(part).plain)}


@pytest.mark.parametrize("total", [60_000, 10_000_000])
def test_on_eighty_columns_figures_and_both_times_are_whole(total):
    lines = drawn(total, lambda bar: bar.update(1000, 0.94, -12.3))
    assert any(re.search(rf" 1000/{total} success  94%  \d+ steps/s ", line) for line in lines), lines
    lines |= drawn(total, lambda bar: bar.busy("certification on highway-env"))
    assert any(line.startswith("certification on highway-env ━") for line in lines)
    for line in lines:
        assert re.search(r" \d:\d\d:\d\d (\d|-):(\d\d|--):(\d\d|--)$", line), line
        assert len(line) <= 80
