"""The process that local workers fork from: it has imported what every run needs.

`multiprocessing` imports this module when it starts the process. The process neither trains nor
touches CUDA, and it has one thread only: threads do not survive a fork. It ends when the sweep and
all workers have ended.
"""

import os
import signal

from parking_exp.garbage_collection import no_garbage_collection
from parking_exp.sweeps.resources import THREAD_VARIABLES

# A terminal or Slurm signals all processes. This one has to outlive the checkpoints of its workers.
STOP_SIGNALS = (signal.SIGHUP, signal.SIGTERM, signal.SIGUSR1, signal.SIGUSR2)


def _set_handlers(handler: signal.Handlers) -> None:
    for number in STOP_SIGNALS:
        signal.signal(number, handler)


_set_handlers(signal.SIG_IGN)
os.register_at_fork(after_in_child=lambda: _set_handlers(signal.SIG_DFL))
# `multiprocessing` ignores Ctrl-C after the imports only.
signal.signal(signal.SIGINT, signal.SIG_IGN)

os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))

# Frozen, else the collections of workers would copy the memory that they share with this process.
with no_garbage_collection(freeze=True):
    import highway_env  # noqa: F401
    import matplotlib.backends.backend_agg  # noqa: F401
    import torch.utils.tensorboard  # noqa: F401

    import parking_exp.training.train_run  # noqa: F401
