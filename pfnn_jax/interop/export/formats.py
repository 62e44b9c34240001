"""The formats of exports. Without JAX, for the options of the command."""

from __future__ import annotations

from typing import Literal

Format = Literal["onnx", "stablehlo", "bins"]
"""A function in ONNX or StableHLO, or the files that the authors' demos read."""
