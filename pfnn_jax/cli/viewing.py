"""Commands to see and drive motion in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import Command
from pfnn_jax.viewer.page.play import LOCAL, play


@dataclass(frozen=True, kw_only=True)
class Play(Command):
    """Drive a character of one or several runs, in a page in the browser, until Ctrl-C.

    Attributes:
        run_paths: runs whose styles can be chosen.
        host: address to listen at. Anything but the default lets other machines reach the page.
        port: where to listen; 0 takes a free port.
        open: open the page in this machine's browser.
    """

    run_paths: Annotated[Argument[tuple[Path, ...]], tyro.conf.arg(name="run", metavar="RUN [RUN...]")]
    host: str = LOCAL
    port: int = 8080
    open: bool = False

    def run(self) -> Any:
        play(self.run_paths, host=self.host, port=self.port, open_browser=self.open)
        return {"runs": self.run_paths}
