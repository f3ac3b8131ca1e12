"""The report's numbers as tables: CSV for those who go on computing, LaTeX for those who write."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from parking_exp.reports import formats
from parking_exp.reports.data import Cell, Content, Interval, Share, Survival
from parking_exp.reports.render.listings import Listing, listings
from parking_exp.runs.atomic import write_atomically

Row = dict[str, Any]
WHOLE = {"seeds", "seed", "seeds_reaching_90", "env_steps", "n", "n_scenes", "step", "slot", "cells", "runs"}
LATEX_ROWS = 60
"""A longer table is of no use on paper."""


def tables(content: Content) -> dict[str, pd.DataFrame]:
    """Return every table that has rows: shares in 0 ... 1, what is not known as NaN.

    Names: `headline` (a row for each cell), `seeds` (for each finished run), `pairs`, `curves` and `survival` (for each
    cell and step), `effects`, `interactions`, `importance`, `slots`, `config` (what differs, a row for each cell),
    `versions` (with commits and machines), `failed`.
    """
    rows = {
        "headline": (_headline(cell) for cell in content.cells),
        "seeds": _seeds(content),
        "pairs": _pairs(content),
        "curves": _curves(content),
        "survival": _survivals(content),
        "effects": _effects(content),
        "interactions": _interactions(content),
        "importance": (vars(found) for found in content.importance),
        "slots": ({**_who(cell), **vars(slot)} for cell in content.cells for slot in cell.slots),
        "config": _config(content),
        "versions": _versions(content),
        "failed": (vars(run) for run in content.provenance.unfinished),
    }
    frames = {name: _frame(found, WHOLE if name != "config" else set()) for name, found in rows.items()}
    return {name: frame for name, frame in frames.items() if len(frame)}


def write_tables(content: Content, folder: Path) -> list[Path]:
    """Write every table as CSV and those fit for a paper as LaTeX (`\\usepackage{booktabs}`); return the files.

    In CSV a text that a spreadsheet would run as a formula gets an apostrophe before it; `report.json` has it as it is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    texts = {f"{name}.csv": _csv(frame) for name, frame in tables(content).items()}
    publishable = listings(content, content.shown)
    for name in ("headline", "pairs", "effects", "interactions", "importance", "config"):
        found = [listing for key, listing in publishable.items() if key.partition("-")[0] == name]
        if found:
            texts[f"{name}.tex"] = "\n".join(latex(listing) for listing in found)
    for name, text in texts.items():
        write_atomically(folder / name, text, durable=False)
    return [folder / name for name in texts]


def latex(listing: Listing) -> str:
    """Return a table for LaTeX with booktabs; `--` where nothing is known."""
    rows = listing.rows[:LATEX_ROWS]
    cut = f" The first {LATEX_ROWS} of {len(listing.rows)} rows." if len(rows) < len(listing.rows) else ""
    frame = pd.DataFrame(
        [[formats.latex(entry.text) or "--" for entry in row] for row in rows],
        columns=[formats.latex(column.title) for column in listing.columns],
    )
    return str(
        frame.style.hide(axis="index").to_latex(
            hrules=True,
            position="htbp",
            position_float="centering",
            caption=formats.latex(listing.caption + cut),
            label=f"tab:{listing.name}",
            column_format="".join("r" if column.numeric else "l" for column in listing.columns),
        )
    )


def _frame(rows: Iterable[Mapping[str, Any]], whole: set[str]) -> pd.DataFrame:
    frame = pd.DataFrame(list(rows))
    for name in frame.columns:
        column = frame[name]
        if name in whole:
            frame[name] = column.astype("Int64")
        elif pd.api.types.is_float_dtype(column):
            frame[name] = column.where(np.isfinite(column))
    return frame


def _csv(frame: pd.DataFrame) -> str:
    safe = frame.copy(deep=False)
    for name in safe.columns:
        if not pd.api.types.is_numeric_dtype(safe[name]):
            safe[name] = safe[name].map(formats.csv)
    safe.columns = pd.Index([formats.csv(name) for name in safe.columns])
    return str(safe.to_csv(index=False, lineterminator="\n", float_format="%.10g"))


def _who(cell: Cell) -> Row:
    return {"cell": cell.id, "label": cell.label}


def _spread(name: str, interval: Interval) -> Row:
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


def _share(count: str, name: str, share: Share) -> Row:
    return {count: share.k, name: formats.rate(share), f"{name}_low": share.low, f"{name}_high": share.high}


def _headline(cell: Cell) -> Row:
    row: Row = {**_who(cell), "experiment": cell.experiment, "name": cell.name, "seeds": len(cell.seeds)}
    row |= {f"runs_{stage}": count for stage, count in cell.counts.items()}
    row["env_steps"] = cell.total_timesteps
    for name in ("success", "parked", "crash", "timeout", "episode_steps", "cpu_s", "area"):
        row |= _spread(name, getattr(cell, name))
    for name, interval in cell.further.items():
        row |= _spread(name, interval)
    row["success_method"] = cell.success.method
    row |= _share("seeds_reaching_90", "share_reaching_90", cell.reaching_90)
    for name, survival in (("steps_to_90", cell.survival), ("cpu_s_to_90", cell.survival_cpu)):
        row |= _time(name, survival)
    return {**row, "note": cell.note}


def _time(name: str, survival: Survival | None) -> Row:
    mean = survival.restricted_mean if survival else Interval(None)
    return {
        f"{name}_median": survival and survival.median,
        **_spread(f"{name}_restricted_mean", mean),
        f"{name}_horizon": survival and survival.horizon,
        f"{name}_reached": survival and survival.k,
    }


def _seeds(content: Content) -> Iterator[Row]:
    for cell in content.cells:
        for seed in cell.seeds:
            values = vars(seed)
            yield {**_who(cell), **{name: value for name, value in values.items() if name != "further"}, **seed.further}


def _pairs(content: Content) -> Iterator[Row]:
    labels = {cell.id: cell.label for cell in content.cells}
    for pair in content.pairs:
        yield {
            "a": pair.a,
            "b": pair.b,
            "a_label": labels[pair.a],
            "b_label": labels[pair.b],
            **_spread("difference", pair.difference),
            "p": pair.p,
            "p_holm": pair.p_holm,
            **_spread("improvement", pair.improvement),
            "log_rank_p": pair.log_rank_p,
            "log_rank_p_holm": pair.log_rank_p_holm,
            "verdict": pair.verdict,
            "note": pair.note,
        }


def _curves(content: Content) -> Iterator[Row]:
    for cell in content.cells:
        if curve := cell.curve:
            columns = (curve.step, curve.mean, curve.low, curve.high, curve.n, curve.crash)
            for step, mean, low, high, n, crash in zip(*columns, strict=True):
                rates = {"success": mean, "success_low": low, "success_high": high, "crash": crash}
                yield {**_who(cell), "step": step, "n": n, **rates}


def _survivals(content: Content) -> Iterator[Row]:
    for cell in content.cells:
        for survival in (cell.survival, cell.survival_cpu):
            if survival is None:
                continue
            for time, reached, low, high in zip(
                survival.time, survival.reached, survival.low, survival.high, strict=True
            ):
                spread = {"reached": reached, "reached_low": low, "reached_high": high}
                yield {**_who(cell), "unit": survival.unit, "time": time, **spread, "censored": False}
            for time in survival.censored:
                yield {**_who(cell), "unit": survival.unit, "time": time, "censored": True}


def _effects(content: Content) -> Iterator[Row]:
    for effect in content.effects:
        largest = {**_spread("largest_difference", effect.largest or Interval(None)), "p_largest_difference": effect.p}
        for level in effect.levels:
            spread = {**_spread("success", level.effect), "cells": level.cells, "n": level.effect.n}
            yield {"factor": effect.factor, "level": level.level, **spread, **largest}


def _interactions(content: Content) -> Iterator[Row]:
    for table in content.interactions:
        for i, row in enumerate(table.rows):
            for j, column in enumerate(table.columns):
                yield {
                    "row_factor": table.row,
                    "row": row,
                    "column_factor": table.column,
                    "column": column,
                    "given": table.given,
                    "success": table.mean[i][j],
                    "success_low": table.low[i][j],
                    "success_high": table.high[i][j],
                    "residual": table.residual[i][j],
                    "n": table.n[i][j],
                    "p_interaction": table.p,
                    "real_share": table.real_share[j] if table.real_share else None,
                }


def _config(content: Content) -> Iterator[Row]:
    if difference := content.provenance.difference:
        for position, cell in enumerate(content.cells):
            yield {**_who(cell), **{key: values[position] for key, values in difference.items()}}


def _versions(content: Content) -> Iterator[Row]:
    found = content.provenance
    for package, versions in found.versions.items():
        for version, runs in versions.items():
            yield {"kind": "package", "name": package, "version": version, "runs": runs}
    for kind, counts in (("commit", found.commits), ("machine", found.machines)):
        for name, runs in counts.items():
            yield {"kind": kind, "name": name, "version": None, "runs": runs}
