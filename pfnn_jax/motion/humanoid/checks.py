"""Confirms a humanoid map by geometry: lengths, directions, sides, and whether the body is a human one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.motion.humanoid.tree import JointTree
from pfnn_jax.motion.skeleton import Skeleton


@dataclass
class Finding:
    """What is decided while a map is found.

    Attributes:
        lines: one for each thing that was decided or is doubtful.
        confidence: in [0, 1].
    """

    lines: list[str] = field(default_factory=list)
    confidence: float = 1.0

    def decide(self, line: str, factor: float = 1.0) -> None:
        """Adds a line, and multiplies the confidence by a factor."""
        self.lines.append(line)
        self.confidence *= factor

    def doubt(self, line: str, factor: float) -> None:
        """Adds a doubt, and multiplies the confidence by a factor."""
        self.decide(f"doubtful: {line}", factor)


def check_geometry(
    found: Mapping[str, Any],
    skeleton: Skeleton,
    tree: JointTree,
    poses: np.ndarray,
    finding: Finding,
    source: str | Path,
) -> None:
    """Adds to the finding what geometry doubts.

    Raises:
        InputError: if the body is not a human one.
    """
