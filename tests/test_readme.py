"""What README and documentation show works, and leads somewhere."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pfnn_jax.motion.gltf.container import read_document
from tests.gltf.rigs import make_rig

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def blocks(language: str, pages: list[Path]) -> list[tuple[str, str]]:
    """(page, code) of every fenced block in a language."""
    found = [(page, match) for page in pages for match in FENCE.findall(page.read_text(encoding="utf-8"))]
    return [(str(page.relative_to(ROOT)), code) for page, (name, code) in found if name == language]


def commands() -> list[tuple[str, ...]]:
    """(page, words of the command) for every `pfnn-jax` line in a shell block."""
    lines = [(page, line.partition("#")[0].split()) for page, code in blocks("sh", PAGES) for line in code.splitlines()]
    return [(page, *words[1:]) for page, words in lines if words and words[0] == "pfnn-jax"]


@pytest.mark.slow
def test_the_example_in_the_readme_runs(tmp_path: Path):
    [(_, code)] = blocks("python", [ROOT / "README.md"])
    home = {**os.environ, "XDG_DATA_HOME": str(tmp_path / "home")}  # styles are not learned in the user's own folder
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, env=home, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "walk.html").stat().st_size > 50_000
    assert (tmp_path / "walk.bvh").exists()


@pytest.mark.slow
def test_the_first_commands_in_the_readme_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from pfnn_jax.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    played = []
    monkeypatch.setattr("pfnn_jax.viewer.page.play.play", lambda paths, **_: played.extend(paths))
    install, *lines = blocks("sh", [ROOT / "README.md"])[0][1].splitlines()
    assert install.startswith("pip install")
    for line in lines:
        program, *words = line.partition("#")[0].split()
        assert program == "pfnn-jax"
        main(words)
    [run] = played
    assert "zombie" in {style.name for style in (run / "styles").iterdir()}


@pytest.mark.slow
def test_the_transfer_in_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from pfnn_jax.cli import main

    monkeypatch.chdir(tmp_path)
    [code] = [code for _, code in blocks("sh", [ROOT / "README.md"]) if "sample" in code and "transfer" in code]
    for line in code.splitlines():
        program, *words = line.split()
        assert program == "pfnn-jax"
        main(words)
    assert (tmp_path / "restyled.bvh").exists()
    assert (tmp_path / "restyled.html").stat().st_size > 50_000


@pytest.mark.slow
def test_the_character_in_the_readme_gets_its_clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from pfnn_jax.cli import main

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    make_rig().write(tmp_path / "hero.glb")
    main(["sample", "zombie", "--out", "zombie.bvh"])
    [code] = [code for _, code in blocks("sh", [ROOT / "README.md"]) if "--onto hero.glb" in code]
    for line in code.splitlines():
        program, *words = line.partition("#")[0].split()
        assert program == "pfnn-jax"
        main(words)
    clips = {name: len(read_document(tmp_path / f"hero_{name}.glb").items("animations")) for name in ("walk", "zombie")}
    assert clips == {"walk": 1, "zombie": 1}
    moves = {clip["name"] for clip in read_document(tmp_path / "hero_moves.glb").items("animations")}
    assert moves >= {"idle", "walk", "walk_left", "walk_right"}


def test_commands_are_shown():
    shown = {command[1] for command in commands()}
    assert shown >= {"prepare", "pretrain", "few-shot", "generate", "label-phase", "transfer", "train-transfer"}


@pytest.mark.parametrize("command", sorted(set(commands())), ids=" ".join)
def test_every_option_shown_exists(command: tuple[str, ...], capsys: pytest.CaptureFixture[str]):
    """The help of the sub-command names each option that a page gives it."""
    from pfnn_jax.cli import main
    from pfnn_jax.cli.command_line import split_command

    name, _ = split_command(command[1:])
    with pytest.raises(SystemExit) as stop:
        main([*name.split(), "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    missing = [word for word in command if word.startswith("--") and word not in text]
    assert not missing


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent == ROOT], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    """Links within `docs` are checked as the documentation is built."""
    targets = re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8"))
    assert targets
    assert not [target for target in targets if not (ROOT / target).exists()]


def test_every_public_name_is_in_the_reference():
    shown = {
        name for page in PAGES for name in re.findall(r"^::: (\S+)", page.read_text(encoding="utf-8"), re.MULTILINE)
    }
    public = {
        f"pfnn_jax.{stub.parent.name}.{name}"
        for stub in (ROOT / "pfnn_jax").glob("*/__init__.pyi")
        for name in re.findall(r" as (\w+)$", stub.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert not public - shown


def cells(path: Path) -> list[tuple[str, str]]:
    """(kind, source) of every cell of a notebook."""
    notebook = json.loads(path.read_text(encoding="utf-8"))
    return [(cell["cell_type"], "".join(cell["source"])) for cell in notebook["cells"]]


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_the_documentation_shows_the_notebook_executed(path: Path):
    """`make notebooks` writes the executed copies."""
    executed = ROOT / "docs" / "notebooks" / path.name
    assert cells(executed) == cells(path)
    assert '"output_type"' in executed.read_text(encoding="utf-8")


def test_notebooks_are_stored_without_outputs():
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        text = path.read_text(encoding="utf-8")
        assert '"outputs": []' in text and '"output_type"' not in text and '"execution_count": null' in text, path.name
