"""Example reports: made-up runs, the same each time, and reports built from them."""

from dataclasses import replace
from functools import cache

import numpy as np

from parking_exp.reports.report_builder import build_report
from parking_exp.reports.report_data import UnfinishedRun
from support.result_frames import Run, results

BUDGET = 40_000
N_SCENES = 100
STEPS = np.arange(2_000, BUDGET + 1, 2_000)
HOSTILE = (
    "<script>window.pwned = 1; alert(1)</script>",
    '"><img src=x onerror="window.pwned=1"> \'quoted\'',
    "</script></style></svg><b>]]> {{7*7}} {% raise %} <!-- --",
    "100% & $x_1$ # {a} ~ ^ \\input{x} \\",
    "=HYPERLINK(1) | a | `code` *b* [c](javascript:alert(1)) @someone\nsecond line",
)


def report(n_cells=3, n_seeds=10, labels=None, look=None, **changes):
    """Return a report on a few algorithms; `labels` are other names for the cells, `changes`
    replace fields.
    """
    names = ("sac", "td3", "ddpg", "tqc", "crossq")
    cells = {}
    for i in range(n_cells):
        learning_rate = 1e-3 * (1 + i // 5)
        cells[str(i)] = {"algorithm.name": names[i % 5], "algorithm.learning_rate": learning_rate}
    others = [0.3 + 0.65 * (i * 7 % n_cells) / n_cells for i in range(3, n_cells)]
    means = {str(i): mean for i, mean in enumerate([0.975, 0.93, 0.71, *others][:n_cells])}
    made = _report(cells, n_seeds, means, look or (lambda label, run: run))
    if labels:
        pairs = zip(made.cells, labels, strict=True)
        made = replace(made, cells=[replace(cell, label=label) for cell, label in pairs])
    return replace(made, **changes)


@cache
def one_seed():
    """Return a report on one cell with one seed: nothing can be said about how sure it is."""
    return report(1, 1)


@cache
def all_succeed():
    """Return a report in which every seed of every cell is at 100 %."""
    return report(2, 10, look=lambda label, run: replace(run, success=1.0, crash=0.0))


@cache
def with_failed_cell():
    """Return a report on two cells with results, and one all of whose runs have failed."""
    failed = Run(
        status="failed",
        error="FloatingPointError: loss is nan",
        curve=(),
    )
    return report(3, 10, look=lambda label, run: failed if label == "2" else run)


@cache
def her_ablation(n_seeds=10):
    """Return a report on strategy x n_sampled_goal."""
    bases = {"future": 0.93, "final": 0.86, "episode": 0.8, "random": 0.55}
    changes = {1: -0.12, 2: -0.03, 4: 0.03, 8: 0.02, 16: -0.06}
    cells = {}
    means = {}
    for strategy, base in bases.items():
        sensitivity = 2 if strategy == "random" else 1
        for k, change in changes.items():
            label = f"{strategy}{k}"
            cells[label] = {"buffer.name": f"her_{strategy}", "buffer.n_sampled_goal": k}
            means[label] = base + change * sensitivity
    return _report(cells, n_seeds, means)


@cache
def hostile():
    """Names that want to run as HTML, JavaScript, Jinja, LaTeX or a spreadsheet's formula."""
    made = report(len(HOSTILE), 5, labels=list(HOSTILE))
    bad = HOSTILE[0]
    provenance = replace(
        made.provenance,
        versions={**made.provenance.versions, bad: {bad: 3}},
        commits={bad: 3},
        machines={HOSTILE[2]: 25},
        difference={HOSTILE[1]: list(HOSTILE), "algorithm.name": ["a", "=1+1", None, True, 0.1]},
        common={HOSTILE[3]: HOSTILE[4], "x": "</script><script>window.pwned = 1</script>"},
        unfinished=[UnfinishedRun(bad, 3, "failed", HOSTILE[4], HOSTILE[1])],
        uri="sqlite:///</script>",
        left_out=list(HOSTILE),
    )
    return replace(
        made,
        title=bad,
        experiments=[bad],
        command=f"python scripts/report.py experiment='{bad}'",
        provenance=provenance,
        claims=[f"{HOSTILE[0]} beats {HOSTILE[3]}."],
        warnings=list(HOSTILE),
        missing=[HOSTILE[2]],
        family=HOSTILE[1],
    )


def _report(cells, n_seeds, means, look=lambda label, run: run):
    """Return a report on cells with these mean rates."""
    rng = np.random.default_rng(len(cells) * 1000 + n_seeds)

    def made(label, seed):
        spread = 0.01 + 0.1 * (1 - means[label])
        rate = float(np.clip(rng.normal(means[label], spread), 0, 1))
        n_success = round(rate * N_SCENES)
        n_crash = round((N_SCENES - n_success) * float(rng.uniform(0.3, 0.9)))
        success = n_success / N_SCENES
        rise = success / (1 + np.exp(-(STEPS - 14_000) / 4_000))
        curve = np.clip(rise + rng.normal(0, 0.03, len(STEPS)), 0, 1)
        cpu_s = float(rng.uniform(150, 220))
        return look(label, Run(success, n_crash / N_SCENES, 0.5, curve, cpu_s=cpu_s))

    common = {"total_timesteps": BUDGET, "evaluation.final_n_scenes": N_SCENES}
    configs = {label: {**common, **changes} for label, changes in cells.items()}
    frames = results(configs, range(n_seeds), made, "algorithms")
    command = "python scripts/report.py experiment=algorithms"
    report = build_report(frames, ["algorithms"], quick=True, command=command)
    return replace(report, quick=False, notes=(), made="2026-11-02T09:30:00Z")
