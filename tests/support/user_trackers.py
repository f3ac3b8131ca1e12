"""Trackers as users write them."""

import json

from parking_exp.training.trackers import Tracker


class WritesJson(Tracker):
    """Append each call to a file, and raise in one of them if asked to."""

    def __init__(self, config, run_dir, fails_in=None):
        super().__init__(config, run_dir)
        self.fails_in = fails_in
        self._append("start", config["seed"])

    def log(self, step, metrics):
        self._append("log", step, metrics)

    def finish(self, status):
        self._append("finish", status)

    def _append(self, call, *values):
        with (self.run_dir.parent / "calls.jsonl").open("a") as file:
            file.write(json.dumps([call, *values]) + "\n")
        if call == self.fails_in:
            raise ConnectionError("no network")


class LacksLog(Tracker):
    """A tracker that can't record anything."""
