"""Unit costs of a search: CPU time of an update and of an env step, measured once for each shape and kept in the study.

Costs of trials are counted in them, so that a machine that is busy changes no result. They are measured in a process
of their own, `python -m parking_exp.tuning.unit_costs`, which reads configs as JSON lines and prints their costs.
"""

import itertools
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, Any

from parking_exp.config.run_key import short_hash
from parking_exp.config.schema import RunConfig
from parking_exp.config.validate import check
from parking_exp.errors import FailedRunError
from parking_exp.tuning.objectives import UnitCosts
from parking_exp.tuning.schema import SearchConfig

if TYPE_CHECKING:
    from optuna import Study

KEY = "unit_costs "
# Keys that the cost of an update or a step depends on.
ALGORITHM = ("_target_", "features", "net_arch", "policy", "policy_kwargs", "batch_size", "policy_delay", "use_sde")
BUFFER = ("_target_", "goal_selection_strategy")
ENV = ("simulator", "vehicles_count", "add_walls", "simulation_frequency", "policy_frequency")
RUN = ("n_envs", "precision", "device", "torch_threads")
REPEATS, SLICE_S = 7, 0.15
MOST_SHAPES = 40


def shape(config: RunConfig) -> str:
    """Return a hash of what the cost of an update and of an env step depends on."""
    plain = config.plain()
    sections = ((plain["algorithm"], ALGORITHM), (plain["buffer"], BUFFER), (plain["env"], ENV), (plain, RUN))
    return short_hash([[section.get(key) for key in keys] for section, keys in sections])


def known_costs(study: "Study", config: RunConfig) -> UnitCosts | None:
    """Return the unit costs of a config's shape, None where they have not been measured."""
    found = study.user_attrs.get(KEY + shape(config))
    return UnitCosts(**found) if found else None


def measure_unit_costs(study: "Study", configs: Iterable[RunConfig]) -> None:
    """Measure the unit costs of shapes that the study has not got, and keep them there.

    Raises:
        FailedRunError: a config can't be measured.
    """
    missing = {shape(config): config for config in configs if known_costs(study, config) is None}
    if not missing:
        return
    lines = "".join(json.dumps(config.plain()) + "\n" for config in missing.values())
    command = [sys.executable, "-m", "parking_exp.tuning.unit_costs"]
    done = subprocess.run(command, input=lines, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FailedRunError(f"unit costs can't be measured: {(done.stderr.strip().splitlines() or ['no reason'])[-1]}")
    for name, line in zip(missing, done.stdout.splitlines(), strict=True):
        if KEY + name not in study.user_attrs:  # another worker may have been faster; the first counts
            study.set_user_attr(KEY + name, json.loads(line))


def shapes(search: SearchConfig, config_of: Callable[[dict[str, Any]], RunConfig]) -> Sequence[RunConfig]:
    """Return a config of each shape that the space has, where these are few; the others are measured as they come.

    Args:
        search: the search.
        config_of: values of keys -> the config of a trial with them.
    """
    base, alternatives = config_of({}), {}
    for key, dimension in search.space.items():
        if dimension.when:
            continue
        other = [value for value in dimension.ends if shape(config_of({key: value})) != shape(base)]
        if other and dimension.choices is None:
            return [base]
        if other:
            alternatives[key] = dimension.choices or []
    found = {shape(base): base}
    for number, values in enumerate(itertools.product(*alternatives.values())):
        if number >= MOST_SHAPES:
            break
        config = config_of(dict(zip(alternatives, values, strict=True)))
        found.setdefault(shape(config), config)
    return list(found.values())


def measure(config: RunConfig) -> UnitCosts:
    """Measure the unit costs of a config in this process: the least of some slices, in CPU time."""
    from stable_baselines3.common.logger import Logger

    from parking_exp.algorithms.build import build_model, torch_settings
    from parking_exp.envs.training_envs import make_training_envs

    with torch_settings(config), closing(make_training_envs(config.env, config.n_envs)) as envs:
        model = build_model(config, envs, seed=0)
        model.set_logger(Logger(None, []))
        model.gradient_steps = 0
        enough = config.env.for_training().episode_steps() * config.n_envs + model.batch_size
        model.learning_starts = enough
        model.learn(enough)
        model.learning_starts = 0

        def step(number: int) -> None:
            model.learn(number * config.n_envs, reset_num_timesteps=False)

        def update(number: int) -> None:
            model.train(gradient_steps=number, batch_size=model.batch_size)

        return UnitCosts(update_s=_least(update), step_s=_least(step) / config.n_envs)


def _least(work: Callable[[int], None]) -> float:
    """Return the least CPU time of one unit of work, over slices of it."""
    number, taken = 4, 0.0
    while True:  # also the warm-up
        begin = time.process_time()
        work(number)
        taken = time.process_time() - begin
        if taken > SLICE_S / 2:
            break
        number *= 2
    times = []
    for _ in range(REPEATS):
        begin = time.process_time()
        work(number)
        times.append((time.process_time() - begin) / number)
    return min(times)


def main() -> None:
    """Print the unit costs of each config on standard input."""
    for line in sys.stdin:
        found = measure(check(RunConfig, json.loads(line)))
        print(json.dumps({"update_s": found.update_s, "step_s": found.step_s}))  # noqa: T201


if __name__ == "__main__":
    main()
