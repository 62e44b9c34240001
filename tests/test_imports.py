"""Who may import whom, and that nothing happens at import."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pfnn_jax"

# room -> rooms it may import besides itself and `errors`. `cli` stands on top; nobody imports it.
MAY_IMPORT = {
    "errors": set(),
    "io": set(),
    "motion": {"io"},
    "models": set(),
    "run": {"io", "motion", "models"},
}
for _next in ("training", "inference", "control", "interop", "workflows", "viewer", "evaluation", "benchmarks", "demo"):
    MAY_IMPORT[_next] = set(MAY_IMPORT)  # each may import those before it
MAY_IMPORT["cli"] = set(MAY_IMPORT)
ROOMS = {path.stem if path.is_file() else path.name for path in PACKAGE.iterdir() if not path.name.startswith("_")}
FILES = sorted(PACKAGE.rglob("*.py"))


def imported_modules(path: Path) -> set[str]:
    """Full names of everything a file imports, wherever in the file: `from a import b` gives `a` and `a.b`."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
            module = ".".join([*package, *([node.module] if node.module else [])])
            names.update([module, *(f"{module}.{alias.name}" for alias in node.names)])
    return names


def room_of(path: Path) -> str:
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


def imports(names: set[str], package: str) -> bool:
    return any(name == package or name.startswith(f"{package}.") for name in names)


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_every_room_has_its_place():
    assert {room for room in ROOMS if room != "__pycache__"} <= set(MAY_IMPORT)


@pytest.mark.parametrize("path", FILES, ids=name)
def test_import_direction(path: Path):
    room = room_of(path)
    if room == "__init__":
        return  # the list of public names
    names = imported_modules(path)
    forbidden = set(MAY_IMPORT) - MAY_IMPORT[room] - {room, "errors"}
    assert not [other for other in sorted(forbidden) if imports(names, f"pfnn_jax.{other}")]
    assert not imports(names, "experiments") and not imports(names, "tests")


@pytest.mark.parametrize("path", FILES, ids=name)
def test_only_the_checkpoint_file_knows_orbax(path: Path):
    assert imports(imported_modules(path), "orbax") == (name(path) == "pfnn_jax/io/checkpoint.py")


@pytest.mark.parametrize("path", sorted((PACKAGE / "motion").rglob("*.py")), ids=name)
def test_motion_is_numpy_alone(path: Path):
    names = imported_modules(path)
    assert not [package for package in ("jax", "flax", "optax", "chex") if imports(names, package)]


@pytest.mark.parametrize("path", sorted((PACKAGE / "models").rglob("*.py")), ids=name)
def test_models_touch_no_files(path: Path):
    names = imported_modules(path)
    assert not [package for package in ("pathlib", "os", "io", "json", "numpy") if imports(names, package)]
    calls = [node.func for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    assert not [call for call in calls if isinstance(call, ast.Name) and call.id == "open"]


def test_motion_imports_without_jax():
    """Preparing data must not wait for an accelerator library, nor need one."""
    modules = ", ".join(
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted((PACKAGE / "motion").rglob("*.py"))
        if path.stem != "__init__"
    )
    run_python(f"import {modules}, sys; assert not {{'jax', 'flax', 'matplotlib'}} & set(sys.modules), 'imported'")


def test_importing_the_package_starts_nothing():
    """No array is made and no device is touched by importing everything."""
    modules = ", ".join(
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in FILES
        if path.stem not in ("__init__", "__main__")
    )
    run_python(
        f"import {modules}\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized(), 'a device was touched at import'"
    )


def run_python(code: str) -> None:
    """Runs code in a fresh interpreter, from the root of the project."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_every_public_name_is_there_and_loaded_only_when_used():
    run_python(
        "import sys, pfnn_jax\n"
        "assert 'jax' not in sys.modules\n"
        "assert 'generate' in dir(pfnn_jax)\n"
        "assert all(hasattr(pfnn_jax, name) for name in dir(pfnn_jax))"
    )
