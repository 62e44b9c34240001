"""`pfnn-jax play`: a character to drive in the browser."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import BASE, Command, open_run


@dataclass(frozen=True, kw_only=True)
class Play(Command):
    """Drive a character in the browser, in the styles of one or several runs. Ctrl-C ends it.

    Attributes:
        run_paths: runs whose styles can be chosen; by default `base`, the network of the package.
        host: address to listen at. With any other than the default, other machines can reach the page.
        port: port to listen at; 0 takes a free one.
        open: open the page in this machine's browser.
        keep_compiled: whether compiled code is kept, so that later starts are faster: in your cache folder, where
            nobody else can read or write it, or where JAX_COMPILATION_CACHE_DIR says.
    """

    run_paths: Annotated[Positional[tuple[Path, ...]], tyro.conf.arg(name="run", metavar="[RUN...]")] = (BASE,)
    host: str = "127.0.0.1"
    port: int = 8080
    open: bool = False
    keep_compiled: bool = True

    def run(self) -> Any:
        from pfnn_jax.viewer.page.background import share_heap

        share_heap()  # before JAX has threads
        paths = [open_run(path) for path in self.run_paths or (BASE,)]
        from pfnn_jax.cli.interrupts import release
        from pfnn_jax.viewer.page.play import play

        release()  # `play` ends its server and its recordings on Ctrl-C
        play(paths, host=self.host, port=self.port, open_browser=self.open, keep_compiled=self.keep_compiled)
        return {"runs": paths}

    def ending(self) -> AbstractContextManager[None]:
        from pfnn_jax.viewer.page.background import ends_with

        return ends_with()
