"""Map of FiLM vectors: t-SNE before and after fine-tuning, and silhouettes of the new styles."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from sklearn.manifold import TSNE
from sklearn.metrics import silhouette_samples

MARKERS = "osD^vPX*"
"""Markers of the new styles, drawn in dark colours; known styles are pale dots."""


def film_map(
    panels: Mapping[str, Mapping[str, np.ndarray]], perplexity: float, seed: int
) -> tuple[Figure, dict[str, dict[str, float]]]:
    """Draws the panels side by side and returns the silhouettes of known and new styles (Mason 2022, Figure 11).

    Args:
        panels: title -> style -> FiLM vectors [W, 4H]; new styles are named `new ...`.
        perplexity: perplexity of t-SNE, lowered if there are few vectors.
        seed: seed of t-SNE.

    Returns:
        The figure, and title -> `known`, `new`: mean silhouette of their vectors among all vectors, from -1 to 1.
    """
    figure = Figure(figsize=(5.2 * len(panels), 4.8), layout="constrained")
    apart = {}
    for axes, (title, styles) in zip(np.atleast_1d(figure.subplots(1, len(panels))), panels.items(), strict=True):
        vectors = np.concatenate(list(styles.values()))
        names = np.concatenate([np.full(len(part), style) for style, part in styles.items()])
        limit = min(perplexity, (len(vectors) - 1) / 3)
        places = TSNE(perplexity=limit, init="pca", random_state=seed).fit_transform(vectors.astype(np.float64))
        silhouettes = np.asarray(silhouette_samples(vectors, names))
        new = np.char.startswith(names, "new ")
        apart[title] = {"known": float(silhouettes[~new].mean()), "new": float(silhouettes[new].mean())}
        _draw(axes, places, names, list(styles))
        axes.set_title(f"{title}: silhouette of new styles {apart[title]['new']:.2f}", loc="left", fontsize=10)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False, fontsize=8)
    return figure, apart


def _draw(axes, places: np.ndarray, names: np.ndarray, styles: list[str]) -> None:
    number = 0
    for index, style in enumerate(styles):
        own = places[names == style]
        if style.startswith("new "):
            marker = MARKERS[number % len(MARKERS)]
            shade = str(0.12 * (number % 5))
            axes.plot(*own.T, marker, markersize=5, color=shade, markerfacecolor="none", label=style)
            number += 1
        else:
            axes.plot(*own.T, "o", markersize=4, color=f"C{index % 10}", alpha=0.45, label=style)
    axes.set(xticks=[], yticks=[])
