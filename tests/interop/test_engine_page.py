"""The loop printed in docs/engines.md equals the loop of the package."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.interop.export.reference_loop import Character
from pfnn_jax.interop.export.run import export_run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "engines.md"
FRAMES = 90
TOLERANCE = 1e-4  # metres, of a float32 network against a float64 one


def test_the_printed_loop_equals_the_reference_loop(runs, tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    run = runs("mason2018", "cp")
    export_run(run.path, "onnx", tmp_path / "exported", style="style1")
    export_run(run.path, "bins", tmp_path / "bins", style="style1")
    [code] = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    printed: dict = {}
    exec(code, printed)
    reference = Character(tmp_path / "bins")
    for frame in range(FRAMES):
        direction = np.exp(0.02j * frame)
        velocity = (1.0 if frame < 60 else 0.0) * direction  # walks a bend, then stops
        reference.step(velocity, direction)
        joints = printed["step"](velocity, direction)
        np.testing.assert_allclose(joints, reference.pose["joint_position"], atol=TOLERANCE)
