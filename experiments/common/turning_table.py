"""Measures of judged walks on disk, and tables of methods that are made from them without running anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common.markdown import markdown_table
from experiments.common.turning_judged import WAYS, JudgedWalks
from pfnn_jax.evaluation.share_closed import Share, share_closed
from pfnn_jax.evaluation.turning_judge import mean_measures
from pfnn_jax.io.files import read_json, write_json, write_whole

NONE, PAPER, FULL_DATA, OWN_TURNS = "no adapter", "paper's recipe", "full data", "own turns"
"""Names of the methods that others are compared with; the full-data network is pretrained with noise on poses."""

NOISY_NONE = "no adapter, pose noise"
"""The network without an adapter, pretrained with noise on poses."""

FULL_PAPER = "full data, paper's network"
"""The full-data network without that noise: in the loop it drifts from its walk on some styles."""

COLUMNS = {
    "turning": "turning, cm",
    "precision": "nearest real turn, cm",
    "recall": "and back, cm",
    "path": "path, cm",
    "turn rate": "turn rate",
    "contacts": "contacts agree",
    "flicker": "flicker",
    "sliding": "sliding",
    "recognised": "recognised",
    "frechet": "Fréchet",
    "failed": "failed",
}
"""Measures of the second table, and their headings."""

Results = Mapping[str, Mapping[tuple[str, int], Mapping[str, JudgedWalks]]]
"""Judged walks by method, by (style, seed) and by way."""


def save_judged(file: Path, judged: Mapping[str, JudgedWalks], **note: Any) -> None:
    """Writes the measures of one method on one fold, and a note, as JSON; NaN becomes null."""
    file.parent.mkdir(parents=True, exist_ok=True)
    ways = {way: {"takes": walks.takes, "style": walks.style} for way, walks in judged.items()}
    write_json(file, {**note, "ways": ways})


def load_judged(file: Path) -> dict[str, JudgedWalks]:
    """Returns the measures that `save_judged` wrote."""
    ways = read_json(file, "must be measures that save_judged wrote")["ways"]
    return {
        way: JudgedWalks([_numbers(take) for take in found["takes"]], _numbers(found["style"]))
        for way, found in ways.items()
    }


def _numbers(measures: Mapping[str, float | None]) -> dict[str, float]:
    return {name: np.nan if value is None else float(value) for name, value in measures.items()}


def write_tables(out: Path, name: str, results: Results) -> None:
    """Writes the tables of results as `NAME.md` into a folder, and prints that of distances."""
    distances = distance_table(results)
    text = "\n".join([distances, *(measures_table(results, way) for way in _ways())])
    write_whole(out / f"{name}.md", text)
    print(distances, flush=True)


def distances_of(results: Results, method: str, way: str, measure: str = "distance") -> dict[str, np.ndarray]:
    """Returns a measure of all takes [seeds, takes] of a method by style, for `share_closed`."""
    folds = results[method]
    styles = sorted({style for style, _ in folds})
    return {
        style: np.stack([walks[way].of_takes(measure) for (own, _), walks in folds.items() if own == style])
        for style in styles
    }


def closed(
    results: Results, method: str, way: str, begin: str = PAPER, end: str = FULL_DATA, measure: str = "distance"
) -> Share | None:
    """Returns the share that a method closes of what `begin` is worse than `end`, on the folds that all three have.

    Returns:
        The share, 0 for `begin` and 1 for `end`; None where one of them is missing on all folds or both are equal.
    """
    if any(name not in results for name in (method, begin, end)):
        return None
    folds = set(results[method]) & set(results[begin]) & set(results[end])
    common = {name: {fold: results[name][fold] for fold in sorted(folds)} for name in (method, begin, end)}
    if not folds:
        return None
    first, last, own = (distances_of(common, name, way, measure) for name in (begin, end, method))
    if all(np.array_equal(first[style], last[style]) for style in first):
        return None
    return share_closed(first, last, own)


def distance_table(results: Results, ends: Sequence[str] = (FULL_DATA, OWN_TURNS)) -> str:
    """Returns the distance in cm of every method (rows), controller / loop, on every fold, and the shares closed.

    Shares are of the distance between the paper's recipe and each of `ends`, with their 95 % intervals.
    """
    folds = sorted({fold for found in results.values() for fold in found})
    names = [style if len({seed for _, seed in folds}) == 1 else f"{style} {seed}" for style, seed in folds]
    headings = [f"closed to {end}, {way}" for end in ends if end in results for way in _ways()]
    rows = []
    for method, found in results.items():
        cells = [_distances(found[fold]) if fold in found else None for fold in folds]
        mean = _pair([float(np.mean([w[way].means()["distance"] for w in found.values()])) for way in _ways()])
        shares = [_share(closed(results, method, way, end=end)) for end in ends if end in results for way in _ways()]
        rows.append([method, *cells, mean if len(found) == len(folds) else None, *shares])
    return markdown_table(["cm, controller / loop", *names, "mean", *headings], rows)


def measures_table(results: Results, way: str = "controller") -> str:
    """Returns the `COLUMNS` of every method (rows) in one way, means over its folds."""
    rows = []
    for method, found in results.items():
        means = mean_measures([walks[way].means() for walks in found.values()])
        rows.append([method, *(None if np.isnan(means[name]) else means[name] for name in COLUMNS)])
    return markdown_table([way, *COLUMNS.values()], rows)


def _ways() -> tuple[str, ...]:
    return WAYS[::-1]  # what users see comes first


def _distances(walks: Mapping[str, JudgedWalks]) -> str:
    return _pair([walks[way].means()["distance"] for way in _ways()])


def _pair(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


def _share(share: Share | None) -> str | None:
    return None if share is None else f"{share.share:.2f} ({share.low:.2f} to {share.high:.2f})"
