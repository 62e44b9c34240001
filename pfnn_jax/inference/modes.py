"""How a network can be evaluated. Without JAX, for the options of the command."""

from __future__ import annotations

from typing import Literal

LookupMode = Literal["nearest50", "constant50"]
"""Which entry of a lookup table is used for a phase: the nearest, or the last one passed, as in the published demo."""

Mode = Literal["cubic", "nearest50", "constant50"]
"""The network itself, or a table of 50 slices of a global phase, whose index is rounded (`nearest50`) or truncated as
in the published demo (`constant50`)."""

LayerNorm = Literal["population", "sample"]
"""Statistics of the layer norm of FiLM runs: the population's, as the authors' demo, or the sample's, as their training
code."""
