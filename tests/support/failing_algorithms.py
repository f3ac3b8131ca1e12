"""Algorithms that end their run in every way that a run can end without a result."""

import json
import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np
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

    def train(self, gradient_steps, batch_size=64):
        time.sleep(0.05)
        super().train(gradient_steps, batch_size)


class Tells(SAC):
    """Writes down what its process was given, and when it began and ended."""

    def learn(self, *arguments, **keywords):
        begin = time.time()
        super().learn(*arguments, **keywords)
        told = {
            "cores": sorted(os.sched_getaffinity(0)),
            "threads": {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS")},
            "torch": torch.get_num_threads(),
            "devices": os.environ.get("CUDA_VISIBLE_DEVICES"),
            "time": [begin, time.time()],
        }
        Path(os.environ["TELLS"], f"{os.getpid()}.json").write_text(json.dumps(told))
        return self


class SavesNothing(SAC):
    """As those of sbx do, which keep their weights elsewhere."""

    def _get_torch_save_params(self):
        return [], []


class SavesNoOptimizer(SAC):
    def _get_torch_save_params(self):
        return ["policy", "actor.optimizer", "ent_coef_optimizer"], ["log_ent_coef"]


class SavesNoTensor(SAC):
    def _setup_model(self):
        super()._setup_model()
        self.scales = {"actions": [torch.rand(2)]}


class SavesNoModule(SAC):
    def _setup_model(self):
        super()._setup_model()
        self.curiosity = Ensemble()


class SavesModules(SAC):
    """And does what SavesNoModule should have done."""

    def _setup_model(self):
        super()._setup_model()
        self.curiosity = torch.nn.Linear(3, 3)

    def _get_torch_save_params(self):
        names, variables = super()._get_torch_save_params()
        return [*names, "curiosity"], variables


class Ensemble:
    def __init__(self):
        self.members = (torch.nn.Linear(3, 3), torch.nn.BatchNorm1d(3))


class NamesNothing(SAC):
    def _get_torch_save_params(self):
        return ["policy", "actr"], []


class CannotBeSaved(SAC):
    def _setup_model(self):
        super()._setup_model()
        self.lock = threading.Lock()


class ActsFromElsewhere(SAC):
    """All of its tensors are saved, and it acts by others, which are not torch's."""

    def _setup_model(self):
        super()._setup_model()
        self.offset = np.random.rand()

    def predict(self, *arguments, **keywords):
        action, state = super().predict(*arguments, **keywords)
        return action + self.offset, state


class HasNoTorch(SAC):
    """As sbx's classes: weights are arrays."""

    def _setup_model(self):
        super()._setup_model()
        self.weights = np.random.rand(2)
        for name in ("policy", "actor", "critic", "critic_target", "log_ent_coef", "ent_coef_optimizer"):
            delattr(self, name)

    def _get_torch_save_params(self):
        return [], []

    def predict(self, observation, *arguments, **keywords):
        return np.tile(self.weights, (len(observation["observation"]), 1)), None
