"""Which package may import which, and what importing one loads."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pfnn_jax"
FILES = sorted(PACKAGE.rglob("*.py"))

# Package -> packages it may import besides itself and `errors`. Nobody imports `cli`.
MAY_IMPORT = {
    "errors": set(),
    "io": set(),
    "motion": {"io"},
    "models": set(),
    "run_config": {"io", "motion", "models"},
    "run": {"io", "motion", "models", "run_config"},
}
_LATER = ("training", "inference", "control", "transfer", "interop", "workflows", "viewer", "evaluation", "benchmarks")
for _next in (*_LATER, "demo"):
    MAY_IMPORT[_next] = set(MAY_IMPORT)  # each may import those before it
MAY_IMPORT["cli"] = set(MAY_IMPORT)


@cache
def parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def imported_modules(path: Path) -> frozenset[str]:
    """Returns the full names of everything that a file imports, anywhere in it: `from a import b` gives `a`, `a.b`."""
    names: set[str] = set()
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = path.relative_to(ROOT).with_suffix("").parts[: -node.level] if node.level else ()
            module = ".".join([*package, *([node.module] if node.module else [])])
            names.update([module, *(f"{module}.{alias.name}" for alias in node.names)])
    return frozenset(names)


def imports(path: Path, *packages: str) -> list[str]:
    """Returns those of the packages that a file imports."""
    names = imported_modules(path)
    return [package for package in packages if any(f"{name}.".startswith(f"{package}.") for name in names)]


def package_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def module_name(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


def run_python(code: str) -> None:
    """Runs code in a fresh interpreter, from the root of the project."""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_packages_import_only_those_below_them():
    wrong = []
    for path in FILES:
        package = package_of(path)
        if package.startswith("__"):
            continue
        above = sorted(set(MAY_IMPORT) - MAY_IMPORT[package] - {package, "errors"})
        forbidden = imports(path, *(f"pfnn_jax.{other}" for other in above), "experiments", "tests")
        wrong += [f"{path.relative_to(ROOT)} imports {other}" for other in forbidden]
    assert not wrong


def test_only_the_checkpoint_module_imports_orbax():
    assert [path.relative_to(PACKAGE).as_posix() for path in FILES if imports(path, "orbax")] == ["io/checkpoint.py"]


def test_motion_does_not_import_jax():
    motion = [path for path in FILES if package_of(path) == "motion"]
    assert not [path for path in motion if imports(path, "jax", "flax", "optax", "chex")]
    modules = ", ".join(module_name(path) for path in motion if path.stem != "__init__")
    run_python(f"import {modules}, sys; assert not {{'jax', 'flax', 'matplotlib'}} & set(sys.modules), 'imported'")


def test_no_module_needs_what_only_one_system_has_to_be_imported():
    """Such modules are imported in a function, or below a comparison of the system."""
    of_one_system = {"fcntl", "grp", "msvcrt", "pty", "pwd", "resource", "termios", "tty", "winreg"}
    found = [node for path in FILES for node in ast.walk(parsed(path)) if isinstance(node, ast.Import)]
    assert {alias.name for node in found for alias in node.names} & of_one_system, "some are used"
    at_once = [node for path in FILES for node in parsed(path).body if isinstance(node, ast.Import | ast.ImportFrom)]
    names = {alias.name for node in at_once for alias in node.names} | {getattr(node, "module", "") for node in at_once}
    assert not names & of_one_system


def test_models_touch_no_files():
    wrong = []
    for path in FILES:
        if package_of(path) == "models":
            wrong += [f"{path.name} imports {name}" for name in imports(path, "pathlib", "os", "io", "json", "numpy")]
            calls = [node.func for node in ast.walk(parsed(path)) if isinstance(node, ast.Call)]
            wrong += [f"{path.name} opens" for call in calls if isinstance(call, ast.Name) and call.id == "open"]
    assert not wrong


def test_importing_every_module_makes_no_array():
    """Importing touches no device either: the first array would start the backend."""
    modules = ", ".join(module_name(path) for path in FILES if path.stem not in ("__init__", "__main__"))
    run_python(
        f"import {modules}\n"
        "from jax._src import xla_bridge\n"
        "assert not xla_bridge.backends_are_initialized(), 'a device was touched at import'"
    )


def test_a_namespace_loads_only_what_is_used():
    run_python(
        "import sys, pfnn_jax as pj\n"
        "assert not {'numpy', 'jax'} & set(sys.modules)\n"
        "dir(pj.models), dir(pj.training), dir(pj.viewer), pj.motion.read_bvh\n"
        "assert 'jax' not in sys.modules and 'matplotlib' not in sys.modules"
    )
