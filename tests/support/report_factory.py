"""Example reports: realistic, made up, and the same each time."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from scipy import stats

from parking_exp.envs.geometry import SLOT_POSITIONS
from parking_exp.reports.report_data import (
    Cell,
    Curve,
    Factor,
    FailedRun,
    Interaction,
    Interval,
    Level,
    MainEffect,
    Pair,
    Path,
    Provenance,
    ReportData,
    Seed,
    SlotRate,
    Survival,
)
from parking_exp.statistics import ParameterImportance, Proportion, wilson_interval

BUDGET = 40_000
STEPS = range(2_000, BUDGET + 1, 2_000)
SCENES = 500
FAMILY = "All pairs of cells on final success; p corrected by Holm's method."
HOSTILE = (
    "<script>window.pwned = 1; alert(1)</script>",
    '"><img src=x onerror="window.pwned=1"> \'quoted\'',
    "</script></style></svg><b>]]> {{7*7}} {% raise %} <!-- --",
    "100% & $x_1$ # {a} ~ ^ \\input{x} \\",
    "=HYPERLINK(1) | a | `code` *b* [c](javascript:alert(1)) @someone\nsecond line",
)


def report(n_cells=3, n_seeds=10, labels=None, **changes):
    """A few algorithms compared; `labels` are other names for the cells, `changes` replace fields."""
    rng = np.random.default_rng(n_cells * 1000 + n_seeds)
    names = ("SAC", "TD3", "DDPG", "TQC", "CrossQ")
    labels = labels or [
        f"{names[i % 5].lower()}" + (f", learning_rate={1e-3 * (1 + i // 5):g}" if n_cells > 5 else "")
        for i in range(n_cells)
    ]
    means = [(0.965, 0.93, 0.71)[i] if i < 3 else 0.3 + 0.65 * (i * 7 % n_cells) / n_cells for i in range(n_cells)]
    settings = [
        {"algorithm": names[i % 5], **({"algorithm.learning_rate": 1e-3 * (1 + i // 5)} if n_cells > 5 else {})}
        for i in range(n_cells)
    ]
    cells = [_cell(i, labels[i], settings[i], means[i], n_seeds, rng) for i in range(n_cells)]
    factors = [] if n_cells == 1 else [Factor("algorithm", "algorithm", [*names[:n_cells]], numeric=False)]
    made = _report(cells, factors, "single" if n_cells == 1 else "list")
    return replace(made, **changes)


@cache
def one_seed():
    """One cell, one seed: nothing can be said about how sure it is."""
    return replace(report(1, 1), exploratory=True)


@cache
def all_succeed():
    """Every seed of every cell at 100 %."""
    made = report(2, 10)
    return replace(made, cells=[_constant(cell, 1.0) for cell in made.cells], pairs=[_same("c0", "c1")])


@cache
def with_failed_cell():
    """Two cells with results, and one all of whose runs have failed."""
    made = report(3, 10)
    nothing = Interval(None)
    failed = replace(
        made.cells[2],
        counts={"done": 0, "running": 0, "failed": 10, "pending": 0},
        **dict.fromkeys(("success", "crash", "timeout", "parked", "episode_steps", "cpu_s", "area"), nothing),
        reaching_90=Proportion(0, 0, None, None),
        seeds=(),
        curve=None,
        survival=None,
        survival_cpu=None,
        slots=(),
        failures=(),
        paths=(),
        note="No seed has finished.",
    )
    unknown = [Pair(a, "c2", nothing, None, None, nothing, None, None, "unknown") for a in ("c0", "c1")]
    runs = [FailedRun(failed.label, s, "failed", "FloatingPointError: loss is nan", f"r/s{s}") for s in range(10)]
    return replace(
        made,
        cells=[*made.cells[:2], failed],
        pairs=[made.pairs[0], *unknown],
        warnings=["10 of 30 runs have failed."],
        provenance=replace(made.provenance, unfinished=runs),
    )


@cache
def her_ablation(n_seeds=10):
    """Strategy x n_sampled_goal."""
    rng = np.random.default_rng(7)
    goals = (1, 2, 4, 8, 16)
    base = {"future": 0.93, "final": 0.86, "episode": 0.8, "random": 0.55}
    bump = {1: -0.12, 2: -0.03, 4: 0.03, 8: 0.02, 16: -0.06}
    cells = [
        _cell(i, f"her_{s}, n_sampled_goal={k}", {"buffer": f"her_{s}", "buffer.n_sampled_goal": k},
              base[s] + bump[k] * (2 if s == "random" else 1), n_seeds, rng)
        for i, (s, k) in enumerate((s, k) for s in base for k in goals)
    ]  # fmt: skip
    strategies = [f"her_{s}" for s in base]
    factors = [
        Factor("buffer", "buffer", strategies, numeric=False),
        Factor("buffer.n_sampled_goal", "n_sampled_goal", goals, numeric=True, log=True),
    ]
    mean, low, high = (
        np.reshape([getattr(cell.success, name) for cell in cells], (4, 5)) for name in ("value", "low", "high")
    )
    by_row, by_column = mean.mean(1), mean.mean(0)
    residual = mean - by_row[:, None] - by_column + mean.mean()
    table = Interaction(
        "buffer", "buffer.n_sampled_goal", None, strategies, goals, mean.tolist(), low.tolist(), high.tolist(),
        [[n_seeds] * 5] * 4, residual.tolist(), [[(1 + row) / (k + 1 + row) for k in goals] for row in range(4)],
    )  # fmt: skip
    effects = [
        MainEffect(factor.key, [
            Level(level, Interval(float(value), float(value) - 0.02, float(value) + 0.02, n_seeds * (20 // len(means)), "t"), 20 // len(means))
            for level, value in zip(factor.levels, means, strict=True)
        ], complete=True)
        for factor, means in zip(factors, (by_row, by_column), strict=True)
    ]  # fmt: skip
    return replace(_report(cells, factors, "factorial"), effects=effects, interactions=[table])


@cache
def search(n_cells=30):
    """Random search over four hyperparameters, three seeds a point."""
    rng = np.random.default_rng(3)
    cells, rates = [], []
    for i in range(n_cells):
        rate = float(10 ** rng.uniform(-4, -2))
        settings = {
            "algorithm.learning_rate": rate,
            "algorithm.gamma": float(1 - 10 ** rng.uniform(-2, -1)),
            "algorithm.batch_size": int(rng.choice([128, 256, 512])),
            "buffer": str(rng.choice(["her_future", "her_final"])),
        }
        mean = 0.95 - 0.35 * abs(np.log10(rate) + 3) + rng.normal(0, 0.03)
        rates.append(rate)
        label = ", ".join(f"{key.rpartition('.')[2]}={_short(value)}" for key, value in settings.items())
        cells.append(_cell(i, label, settings, float(np.clip(mean, 0, 0.99)), 3, rng))
    factors = [
        Factor("algorithm.learning_rate", "learning_rate", sorted(rates), numeric=True, log=True),
        Factor("algorithm.gamma", "gamma", sorted(c.settings["algorithm.gamma"] for c in cells), numeric=True),
        Factor("algorithm.batch_size", "batch_size", [128, 256, 512], numeric=True),
        Factor("buffer", "buffer", ["her_final", "her_future"], numeric=False),
    ]
    importance = [
        ParameterImportance("algorithm.learning_rate", 0.71, 0.001, -0.42),
        ParameterImportance("algorithm.gamma", 0.06, 0.3, 0.12),
        ParameterImportance("algorithm.batch_size", 0.02, 0.71, 0.08),
        ParameterImportance("buffer", 0.01, 0.9, None),
    ]
    made = _report(cells, factors, "search", baseline="c0")
    return replace(made, importance=importance, exploratory=True)


@cache
def hostile():
    """Names that want to run as HTML, JavaScript, Jinja, LaTeX, Markdown or a spreadsheet's formula."""
    made = report(len(HOSTILE), 5, labels=list(HOSTILE))
    bad = HOSTILE[0]
    provenance = replace(
        made.provenance,
        versions={**made.provenance.versions, bad: {bad: 3}},
        commits={bad: 3},
        machines={HOSTILE[2]: 25},
        difference={HOSTILE[1]: list(HOSTILE), "algorithm.name": ["a", "=1+1", None, True, 0.1]},
        common={HOSTILE[3]: HOSTILE[4], "x": "</script><script>window.pwned = 1</script>"},
        unfinished=[FailedRun(bad, 3, "failed", HOSTILE[4], HOSTILE[1])],
        uri="sqlite:///</script>",
        left_out=list(HOSTILE),
    )
    return replace(
        made, title=bad, experiments=[bad], command=f"python scripts/report.py experiment='{bad}'", provenance=provenance,
        claims=[f"{HOSTILE[0]} beats {HOSTILE[3]}."], warnings=list(HOSTILE), missing=[HOSTILE[2]], family=HOSTILE[1],
    )  # fmt: skip


@cache
def non_ascii():
    """Names in several scripts."""
    labels = ["Größe α 学習", "Вариант Б, γ=0,95", "🚗 naïve Δt ≤ 5 µs"]  # noqa: RUF001
    return report(3, 10, labels=labels, title="Straße 駐車")


@cache
def many(n_cells=500, n_seeds=2):
    """More cells than figures can show."""
    return report(n_cells, n_seeds)


def _report(cells, factors, design, baseline=None):
    seeds = max(len(cell.seeds) for cell in cells)
    if len(cells) > 40:
        baseline = "c0"
    best = sorted(cells, key=lambda cell: -(cell.success.value or 0))
    pairs = [] if len(cells) == 1 else _pairs(cells, baseline)
    claims = [f"{best[0].label} parks best: {best[0].success.value:.1%} of the scenes."]
    if len(cells) > 1:
        claims += [
            f"{best[0].label} and {best[1].label} can't be told apart.",
            f"{best[0].label} is better than {best[-1].label}.",
        ]
    return ReportData(
        title="algorithms",
        experiments=["algorithms"],
        made="2026-11-02T09:30:00Z",
        version="0.5.0",
        quick=False,
        command="python scripts/report.py experiment=algorithms",
        design=design,
        factors=factors,
        cells=cells,
        shown=[cell.id for cell in (cells if len(cells) <= 12 or design == "factorial" else best[:12])],
        baseline=baseline,
        reference=baseline,
        family=FAMILY,
        pairs=pairs,
        effects=(),
        interactions=(),
        importance=(),
        exploratory=seeds < 10,
        claims=claims,
        warnings=[],
        missing=[],
        provenance=_provenance(cells),
    )


def _provenance(cells):
    n = sum(len(cell.seeds) for cell in cells)
    keys = sorted({key for cell in cells for key in cell.settings}) if len(cells) > 1 else []
    return Provenance(
        versions={"parking-exp": {"0.5.0": n}, "highway-env": {"1.12.1": n}, "torch": {"2.13.0": n}},
        commits={"8f6f639a1c": n},
        machines={"AMD EPYC 7B13, 2 cores": n},
        difference={key: [cell.settings.get(key) for cell in cells] for key in keys},
        common={"env.duration": 20, "env.id": "parking-v0", "total_timesteps": BUDGET, "algorithm.gamma": 0.95},
        unfinished=(),
        uri="sqlite:///outputs/mlflow.db",
        first="2026-11-01T08:00:00Z",
        last="2026-11-02T09:00:00Z",
    )


def _cell(index, label, settings, mean, n_seeds, rng):
    rates = np.clip(rng.normal(mean, 0.02 + 0.2 * (1 - mean), n_seeds), 0, 1)
    seeds = [_seed(index, number, round(float(rate) * SCENES), rng) for number, rate in enumerate(rates)]
    curve = _curve(seeds, rng)
    return Cell(
        id=f"c{index}",
        label=label,
        experiment="algorithms",
        name=f"cell-{index}",
        settings=settings,
        counts={"done": n_seeds, "running": 0, "failed": 0, "pending": 0},
        total_timesteps=BUDGET,
        success=_mean([s.success for s in seeds]),
        crash=_mean([s.crash for s in seeds]),
        timeout=_mean([s.timeout for s in seeds]),
        parked=_mean([s.parked for s in seeds]),
        episode_steps=_mean([s.episode_steps for s in seeds]),
        cpu_s=_mean([s.cpu_s for s in seeds]),
        area=_mean([s.area for s in seeds]),
        reaching_90=_share(sum(s.success >= 0.9 for s in seeds), n_seeds),
        seeds=seeds,
        curve=curve,
        survival=_survival("env steps", [s.steps_to_90 for s in seeds], [s.reached_90 for s in seeds]),
        survival_cpu=_survival("CPU-seconds", [s.cpu_s_to_90 for s in seeds], [s.reached_90 for s in seeds]),
        slots=_slots(mean, n_seeds, rng),
        failures=_failures(mean, n_seeds, rng),
        paths=[_path(outcome, n, rng) for n, outcome in enumerate(("success", "success", "crash", "timeout"))],
    )


def _seed(index, number, successes, rng):
    success = successes / SCENES
    crash = round((1 - success) * float(rng.uniform(0.3, 0.9)), 3)
    low, high = wilson_interval(successes, SCENES)
    reached = success >= 0.9
    steps = int(rng.choice(STEPS[6:16])) if reached else BUDGET
    cpu = float(rng.uniform(150, 220))
    return Seed(
        seed=number,
        run_id=f"{index:04x}{number:04x}",
        run_dir=f"outputs/algorithms/cell-{index}/seed={number}",
        success=success,
        crash=crash,
        timeout=round(1 - success - crash, 3),
        parked=round(success * 0.6, 3),
        n_scenes=SCENES,
        low=low,
        high=high,
        episode_steps=float(rng.uniform(18, 40)),
        cpu_s=cpu,
        steps_to_90=steps,
        reached_90=reached,
        cpu_s_to_90=cpu * steps / BUDGET,
        area=success * 0.7,
    )


def _curve(seeds, rng):
    steps = np.array(STEPS)
    rise = 1 / (1 + np.exp(-(steps - 14_000) / 4_000))
    rates = np.array([np.clip(s.success * rise + rng.normal(0, 0.03, len(steps)), 0, 1) for s in seeds])
    means = [_mean(column.tolist()) for column in rates.T]
    return Curve(
        step=steps.tolist(),
        mean=[m.value for m in means],
        low=[m.low for m in means],
        high=[m.high for m in means],
        n=[len(seeds)] * len(steps),
        crash=((1 - rates.mean(0)) * 0.6).tolist(),
        seeds=[(s.seed, steps.tolist(), rate.tolist()) for s, rate in zip(seeds, rates, strict=True)],
    )


def _survival(unit, times, reached):
    events = sorted(t for t, done in zip(times, reached, strict=True) if done)
    censored = [t for t, done in zip(times, reached, strict=True) if not done]
    n = len(times)
    shares = [_share(sum(t <= now for t in events), n) for now in (0, *sorted(set(events)))]
    values = [share.k / n for share in shares]
    return Survival(
        unit=unit,
        time=[0, *sorted(set(events))],
        reached=values,
        low=[share.low for share in shares],
        high=[share.high for share in shares],
        censored=censored,
        n=n,
        k=len(events),
        median=next((t for t, v in zip((0, *sorted(set(events))), values, strict=True) if v >= 0.5), None),
        restricted_mean=_mean([float(t) for t in times]),
        horizon=float(max(times)),
    )


def _slots(mean, n_seeds, rng):
    n = SCENES * n_seeds // 28
    made = []
    for slot, (x, _) in enumerate(SLOT_POSITIONS):
        success = float(np.clip(mean - 0.15 * (abs(x) / 26) ** 2 + rng.normal(0, 0.02), 0, 1))
        made.append(SlotRate(slot, n, success, (1 - success) * 0.6, (1 - success) * 0.4))
    return made


def _failures(mean, n_seeds, rng):
    n = int(min(200, (1 - mean) * SCENES * n_seeds / 4))
    return [
        (float(rng.uniform(-34, 34)), float(rng.choice([-1, 1]) * rng.uniform(6, 20)), ("crash", "timeout")[i % 3 == 0])
        for i in range(n)
    ]


def _path(outcome, number, rng):
    slot = int(rng.integers(28))
    x, y = SLOT_POSITIONS[slot]
    t = np.linspace(0, 1, {"success": 30, "crash": 18, "timeout": 100}[outcome])
    reach = {"success": 1.0, "crash": 0.8, "timeout": 0.6}[outcome]
    xs, ys = reach * x * np.sin(t * np.pi / 2), reach * y * t**2
    if outcome == "crash":
        xs = xs + 6 * t**3
    if outcome == "timeout":
        xs, ys = xs + 2 * np.cos(12 * t), ys + 2 * np.sin(12 * t)
    heading = np.arctan2(np.gradient(ys), np.gradient(xs))
    parked = sorted(int(s) for s in rng.choice(28, 4, replace=False) if s != slot)
    return Path(
        number % 3, 1000 + number, outcome, slot, xs.tolist(), ys.tolist(), heading.tolist(), len(xs) - 1, parked
    )


def _pairs(cells, baseline):
    found = combinations(cells, 2) if baseline is None else ((cell, cells[0]) for cell in cells if cell.id != baseline)
    return [_pair(a, b) for a, b in found]


def _pair(a, b):
    xs, ys = (np.array([seed.success for seed in cell.seeds]) for cell in (a, b))
    gain = float(np.mean((xs[:, None] > ys) + 0.5 * (xs[:, None] == ys)))
    difference = float(xs.mean() - ys.mean())
    if len(xs) < 2:
        return Pair(a.id, b.id, Interval(difference, n=1), None, None, Interval(gain, n=1), None, None, "unknown")
    half = 2.1 * float(np.sqrt(xs.var(ddof=1) / len(xs) + ys.var(ddof=1) / len(ys)))
    p = float(2 * stats.norm.sf(2.1 * abs(difference) / half))
    holm = min(1.0, p * 3)
    return Pair(
        a=a.id,
        b=b.id,
        difference=Interval(difference, difference - half, difference + half, len(xs) + len(ys), "t"),
        p=p,
        p_holm=holm,
        improvement=Interval(gain, max(0.0, gain - 0.2), min(1.0, gain + 0.2), len(xs) + len(ys), "bootstrap"),
        log_rank_p=p * 1.5 if p < 0.5 else None,
        log_rank_p_holm=holm if p < 0.5 else None,
        verdict="same" if holm >= 0.05 else "a" if difference > 0 else "b",
    )


def _same(a, b):
    return Pair(a, b, Interval(0.0, None, None, 20), None, None, Interval(0.5, None, None, 20), 0.7, 0.7, "same")


def _constant(cell, rate):
    fixed = {"success": rate, "crash": 0.0, "timeout": 1 - rate, "parked": rate, "low": 0.992, "high": 1.0}
    return replace(
        cell,
        success=Interval(rate, None, None, len(cell.seeds)),
        crash=Interval(0.0, None, None, len(cell.seeds)),
        timeout=Interval(1 - rate, None, None, len(cell.seeds)),
        parked=Interval(rate, None, None, len(cell.seeds)),
        reaching_90=_share(len(cell.seeds), len(cell.seeds)),
        seeds=[replace(seed, **fixed, reached_90=True) for seed in cell.seeds],
        note="All seeds agree: there is no variation to make an interval from.",
    )


@cache
def _quantile(degrees):
    return stats.t.ppf(0.975, degrees)


def _mean(values):
    n = len(values)
    mean = float(np.mean(values))
    if n < 2 or np.ptp(values) == 0:
        return Interval(mean, n=n)
    half = float(_quantile(n - 1) * np.std(values, ddof=1) / np.sqrt(n))
    return Interval(mean, mean - half, mean + half, n, "t")


def _share(k, n):
    return Proportion(k, n, *wilson_interval(k, n)) if n else Proportion(0, 0, None, None)


def _short(value):
    return f"{value:.3g}" if isinstance(value, float) else value
