"""The public names: what the stubs list is what Python finds and what a type checker sees."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import pfnn_jax

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pfnn_jax"
NAMESPACES = ("motion", "models", "training", "control", "workflows", "viewer")


def stub_names(namespace: str) -> Iterator[tuple[str, str]]:
    """Yields (module, name) for every public name that the stub of a namespace lists."""
    for node in ast.parse((PACKAGE / namespace / "__init__.pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            assert node.level == 1 and node.module
            for alias in node.names:
                assert alias.asname == alias.name, f"{alias.name}: a stub re-exports a name as itself"
                yield f"pfnn_jax.{namespace}.{node.module}", alias.name


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_every_public_name_is_what_its_stub_says(namespace: str):
    package = getattr(pfnn_jax, namespace)
    listed = list(stub_names(namespace))
    assert sorted(package.__all__) == sorted(dir(package)) == sorted(name for _, name in listed)
    for module, name in listed:
        assert getattr(package, name) is getattr(sys.modules[module], name), name


@pytest.mark.parametrize("namespace", NAMESPACES)
def test_no_module_of_a_namespace_hides_a_public_name(namespace: str):
    """An imported module becomes an attribute of its package, in place of a lazily loaded name."""
    modules = {path.stem for path in (PACKAGE / namespace).iterdir()}
    assert not modules & {name for _, name in stub_names(namespace)}


def test_the_package_lists_its_namespaces():
    assert set(vars(pfnn_jax)["__all__"]) == {
        *NAMESPACES,
        "InputError",
        "LostProcessError",
        "TrainingError",
        "__version__",
    }
    with pytest.raises(AttributeError):
        _ = pfnn_jax.nonsense  # pyright: ignore[reportAttributeAccessIssue]


USER_SCRIPT = """
from pathlib import Path

import pfnn_jax as pj

version: str = pj.__version__
clips = [clip for clip in pj.motion.synthetic_clips("old", seconds=15.0)]
dataset: pj.motion.Dataset = pj.motion.prepare(clips, Path("data"), pj.motion.PrepareConfig())
config = pj.training.PretrainConfig(hidden=64, steps=500, learning_rate=1e-3)
run: pj.workflows.Run = pj.workflows.load_run("run")
styles: tuple[str, ...] = pj.workflows.list_styles(run.path)
network: pj.models.Network = run.shared
clip: pj.motion.MotionClip = pj.motion.read_bvh("clip.bvh")
few_shot = pj.training.FewShotConfig(rank=5)
controller: pj.control.Controller = pj.control.make_controller(run)
try:
    pj.motion.write_bvh("walk.bvh", pj.control.fix_feet(clip))
except pj.InputError as error:
    print(error.file, error.place)
"""

MISTAKES = """
import pfnn_jax as pj

pj.nonsense
pj.motion.nonsense
pj.training.PretrainConfig(hiden=3)
few_shot: int = pj.motion.read_bvh("clip.bvh")
"""


def test_a_type_checker_sees_the_public_names(tmp_path: Path):
    (tmp_path / "user_script.py").write_text(USER_SCRIPT)
    (tmp_path / "mistakes.py").write_text(MISTAKES)
    (tmp_path / "pyrightconfig.json").write_text(
        f'{{"typeCheckingMode": "standard", "reportUnknownMemberType": "error", "extraPaths": ["{ROOT.as_posix()}"]}}'
    )
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "--project", str(tmp_path)]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=300).stdout
    errors = [line.partition(".py:")[2] for line in shown.splitlines() if " error: " in line]
    assert "user_script.py" not in shown, shown
    assert sorted({int(line.partition(":")[0]) for line in errors}) == [4, 5, 6, 7], shown
