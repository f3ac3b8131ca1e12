"""A launcher as users write it."""

import time

from parking_exp.sweeps.supervisor import supervise_job


class Sequential:
    """Trains one run after the other, with a pause between them."""

    def __init__(self, pause_s: float = 0.0) -> None:
        self.pause_s = pause_s

    def train(self, paths):
        for path in paths:
            print("Sequential", path.name, flush=True)
            supervise_job(path)
            time.sleep(self.pause_s)
