"""Tests of the public API: public paths, lazy imports, import cost."""

import ast
import itertools
import re
import sys
import tomllib
from importlib import import_module
from importlib.metadata import packages_distributions

import pytest
from support.runs import ROOT, run_code

from parking_exp import compose
from parking_exp.config.schema import RunConfig
from parking_exp.errors import ConfigError

# All that a `_target_` or the documentation names. These paths stay: a `_target_` is part of a
# run's key.
PUBLIC_PATHS = (
    "parking_exp.compose",
    "parking_exp.load",
    "parking_exp.load_model",
    "parking_exp.train",
    "parking_exp.algorithms.DDPG",
    "parking_exp.algorithms.SAC",
    "parking_exp.algorithms.TD3",
    "parking_exp.algorithms.action_noise.EpsilonRandomActionNoise",
    "parking_exp.algorithms.crossq.CrossQ",
    "parking_exp.envs",
    "parking_exp.tasks.parking.features.EgoFrameExtractor",
    "parking_exp.tasks.parking.features.FineEgoFrameExtractor",
    "parking_exp.algorithms.policy_files.load_policy",
    "parking_exp.buffers.HerBuffer",
    "parking_exp.tasks.parking.reward.ParkingReward",
    "parking_exp.tasks.parking.highway_lot",
    "parking_exp.tasks.parking.lot.lot_of",
    "parking_exp.tasks.parking.nearby_vehicles.NearbyVehicles",
    "parking_exp.tasks.parking.nearby_vehicles.RandomVehiclesCount",
    "parking_exp.tasks.parking.planning.Planner",
    "parking_exp.tasks.parking.rays.Rays",
    "parking_exp.tasks.parking.obstacles",
    "parking_exp.tasks.parking.obstacles.RandomObstacles",
    "parking_exp.tasks.parking.scenes.Scenes",
    "parking_exp.tasks.parking.simulator.Simulator",
    "parking_exp.tasks.parking.vec_env.ParkingVecEnv",
    "parking_exp.tasks.metrics.Metric",
    "parking_exp.tasks.scripted_policy.ScriptedPolicy",
    "parking_exp.tasks.task.Task",
    "parking_exp.tasks.vectorized_task.VectorizedTask",
    "parking_exp.results.load",
    "parking_exp.results.read_export",
    "parking_exp.statistics",
    "parking_exp.sweeps.local.LocalLauncher",
    "parking_exp.sweeps.slurm.SlurmLauncher",
    "parking_exp.sweeps.supervisor.supervise_job",
    "parking_exp.report_section.Column",
    "parking_exp.report_section.Section",
    "parking_exp.report_section.SectionFigure",
    "parking_exp.report_section.Table",
    "parking_exp.training.trackers.Tracker",
)
TARGET = re.compile(r"_target_: (parking_exp\.[\w.]+)")
NAMED = re.compile(r"\bparking_exp(?:\.\w+)+")
IMPORTED = re.compile(r"^from (parking_exp[\w.]*) import ([\w, ]+)", re.MULTILINE)
ROOMS = {path.parent.name for path in (ROOT / "parking_exp").glob("*/__init__.py")}


@pytest.mark.parametrize("path", PUBLIC_PATHS)
def test_every_public_path_resolves(path):
    module, _, name = path.rpartition(".")
    assert hasattr(import_module(module), name) or import_module(path)


def test_every_target_of_ours_in_conf_is_a_public_path():
    found = {
        name
        for path in (ROOT / "conf").rglob("*.yaml")
        for name in TARGET.findall(path.read_text())
    }
    assert found
    assert found <= set(PUBLIC_PATHS)


@pytest.mark.parametrize(
    "document", sorted((ROOT / "docs").glob("*.md")), ids=lambda path: path.name
)
def test_documents_name_public_paths_and_rooms_alone(document):
    text = document.read_text(encoding="utf-8")
    found = {
        f"{module}.{name.strip()}"
        for module, names in IMPORTED.findall(text)
        for name in names.split(",")
    }
    found |= set(NAMED.findall(IMPORTED.sub("", text)))
    assert found - set(PUBLIC_PATHS) - {f"parking_exp.{room}" for room in ROOMS} == set()


@pytest.mark.parametrize(
    ("package", "heavy"),
    [
        ("parking_exp", {"torch", "mlflow", "pandas", "hydra", "pydantic"}),
        ("parking_exp.statistics", {"torch", "pandas", "scipy"}),
    ],
)
def test_importing_a_package_imports_nothing_heavy(package, heavy):
    code = f"import sys, {package}; print({heavy} & set(sys.modules))"
    assert run_code(code, cwd=ROOT).stdout == "set()\n"


def _imported(path):
    """Names of the top-level packages that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module.partition(".")[0]


def test_every_package_that_is_imported_is_declared():
    """The extras count as well: what needs one of them says so when it is missing."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [
        project["optional-dependencies"][extra]
        for extra in ("contrib", "export", "bench", "planning", "slurm", "ray")
    ]
    declared = [
        re.match(r"[\w-]+", line)[0] for line in itertools.chain(project["dependencies"], *extras)
    ]
    names = {name.lower().replace("_", "-") for name in declared}
    imported = {name for path in (ROOT / "parking_exp").rglob("*.py") for name in _imported(path)}
    owners = packages_distributions()
    third_party = imported - sys.stdlib_module_names - {"parking_exp"}
    assert [
        n
        for n in third_party
        if not {owner.lower().replace("_", "-") for owner in owners[n]} & names
    ] == []


def test_a_composed_config_is_checked_and_of_one_run():
    config = compose("experiment=smoke", "seed=3")
    assert isinstance(config, RunConfig)
    assert (config.experiment_name, config.seed) == ("smoke", 3)
    with pytest.raises(ConfigError, match="2 runs"):
        compose("seed=1,2")
    with pytest.raises(ConfigError, match=r"^n_envs=0: "):
        compose("n_envs=0")
