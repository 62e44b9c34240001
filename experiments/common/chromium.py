"""Flags of Chromium for machines without a screen or a graphics card."""

from __future__ import annotations

FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")
