"""The code printed in docs/engines.md runs on an export and nothing else, and its loop equals that of the package."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.interop.export.reference_loop import PublishedLoop, load
from pfnn_jax.interop.export.run import export_run

PAGE = Path(__file__).resolve().parents[2] / "docs" / "engines.md"
FRAMES = 90
TOLERANCE = 1e-4  # metres, of a float32 network against a float64 one


def printed_code() -> list[str]:
    return re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_a_stranger_drives_a_character_with_the_printed_code_alone(runs, tmp_path):
    """In a fresh interpreter that finds no package but the exported folder's, and in the folder above that."""
    pytest.importorskip("onnxruntime")
    export_run(runs("mason2022", "film").path, "onnx", tmp_path / "exported", style="style1")
    code = [block for block in printed_code() if "def step(" not in block]
    assert len(code) >= 3
    shown = (
        "print(abs(np.linalg.norm(character.local_rotations, axis=-1) - 1.0).max() < 1e-6, 'pfnn_jax' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", "\n".join([*code, shown])], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert (done.stdout, done.stderr) == ("True False\n", "")


def test_the_printed_loop_equals_the_reference_loop(runs, recorded_walks, tmp_path, monkeypatch):
    pytest.importorskip("onnxruntime")
    run = runs("mason2018", "cp")
    export_run(run.path, "onnx", tmp_path / "exported", style="style1")
    export_run(run.path, "bins", tmp_path / "bins", style="style1")
    [code] = [block for block in printed_code() if "def step(" in block]
    monkeypatch.chdir(tmp_path)
    printed: dict = {}
    exec(code, printed)
    description, evaluate, _ = load(tmp_path / "bins")
    reference = PublishedLoop(description, evaluate)
    for frame in range(FRAMES):
        direction = np.exp(0.02j * frame)
        velocity = (1.0 if frame < 60 else 0.0) * direction  # walks a bend, then stops
        reference.step(velocity, direction)
        joints = printed["step"](velocity, direction)
        np.testing.assert_allclose(joints, reference.pose["joint_position"], atol=TOLERANCE)
