"""Algorithms as users write them: some end their run without a result, in every way that there is,
some lose weights, one takes its time, and one tells what its process was given.
"""

import json
import os
import signal
import sys
import time
from pathlib import Path

import torch

from parking_exp.algorithms import SAC


class Raises(SAC):
    def train(self, gradient_steps, batch_size=64):
        raise RuntimeError("a bad <day> [bold]")


class Exits(SAC):
    def train(self, gradient_steps, batch_size=64):
        sys.exit(3)


class IsKilled(SAC):
    def train(self, gradient_steps, batch_size=64):
        os.kill(os.getpid(), signal.SIGKILL)


class Vanishes(SAC):
    def train(self, gradient_steps, batch_size=64):
        os._exit(0)


class Hangs(SAC):
    def train(self, gradient_steps, batch_size=64):
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        while True:
            time.sleep(1)


class Lingers(SAC):
    """Takes its time, so that a test can step in."""

    pause_s = 0.05

    def train(self, gradient_steps, batch_size=64):
        time.sleep(self.pause_s)
        super().train(gradient_steps, batch_size)


class Tells(SAC):
    """Writes down what its process was given, and when it began and ended."""

    def learn(self, *arguments, **keywords):
        begin = time.time()
        super().learn(*arguments, **keywords)
        conditions = {
            "cores": sorted(os.sched_getaffinity(0)),
            "threads": {
                name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")
            },
            "torch": torch.get_num_threads(),
            "devices": os.environ.get("CUDA_VISIBLE_DEVICES"),
            "parent": os.getppid(),
            "session": os.getsid(0),
            "store_modules": sorted({"mlflow", "sqlalchemy", "alembic"} & {*sys.modules}),
            "time": [begin, time.time()],
        }
        Path(os.environ["TELLS"], f"{os.getpid()}.json").write_text(json.dumps(conditions))
        return self


class ForgetsExtraNetwork(SAC):
    """Has a network of its own, which is not saved."""

    def _setup_model(self):
        super()._setup_model()
        self.curiosity = torch.nn.Linear(3, 3)


class SavesExtraNetwork(ForgetsExtraNetwork):
    """Names its own network among what is saved."""

    def _get_torch_save_params(self):
        names, variables = super()._get_torch_save_params()
        return [*names, "curiosity"], variables


class SavesNothing(SAC):
    """As classes of sbx, which keep their weights elsewhere."""

    def _get_torch_save_params(self):
        return [], []
