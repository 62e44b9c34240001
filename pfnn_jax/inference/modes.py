"""How a network can be evaluated. Without JAX, for the options of the command."""

from __future__ import annotations

from typing import Literal

Mode = Literal["cubic", "nearest50", "constant50"]
"""The network itself, or a table of 50 slices of a global phase, whose index is rounded (`nearest50`) or truncated as
in the published demo (`constant50`)."""

LayerNorm = Literal["population", "sample"]
"""Statistics of the layer norm of FiLM runs: the population's, as the authors' demo, or the sample's, as their training
code."""
