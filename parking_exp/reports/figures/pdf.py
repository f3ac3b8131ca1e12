"""Draw the PDFs in a second process.

To embed their fonts takes as long as all other formats together: of a report on 34 cells with 30 seeds each, PDFs are
3 to 6 of the 8 to 11 CPU-seconds that drawing and writing take.
"""

import gc
import os
import pickle
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Self

from parking_exp.reports.report_data import ReportData

PACKAGE_PARENT = Path(__file__).resolve().parents[3]


class PdfProcess:
    """A process that draws PDFs, started before there is anything to draw, since its imports take a second.

    It ends with the `with` block at the latest.
    """

    def __init__(self) -> None:
        path = os.pathsep.join(filter(None, (str(PACKAGE_PARENT), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(
            [sys.executable, "-m", "parking_exp.reports.figures.pdf"],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": path},
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    def draw(self, report: ReportData, folder: Path) -> None:
        """Begin to draw all pictures into a folder."""
        assert self._process.stdin is not None
        pickle.dump((report, folder), self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()

    def wait(self) -> None:
        """Wait until they are drawn.

        Raises:
            RuntimeError: they are not; what the process has said goes with it.
        """
        _, said = self._process.communicate()
        if self._process.returncode:
            raise RuntimeError(f"the PDFs could not be drawn: {said.decode(errors='replace').strip()}")


def main() -> None:
    """Draw what comes in as a pickle from the process that started this one."""
    from parking_exp.reports.figures.export import draw

    gc.disable()  # everything made here stays to the end
    try:
        report, folder = pickle.load(sys.stdin.buffer)
    except EOFError:  # it has come to nothing
        return
    draw(report, folder, ["pdf"])
    gc.freeze()


if __name__ == "__main__":
    main()
