"""How Chromium is started where there is no screen and no graphics card."""

from __future__ import annotations

FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
