"""Algorithms that end their run in every way that a run can end without a result."""

import os
import signal
import sys
import time

from parking_exp.lean import SAC


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

    def train(self, gradient_steps, batch_size=64):
        time.sleep(0.05)
        super().train(gradient_steps, batch_size)
