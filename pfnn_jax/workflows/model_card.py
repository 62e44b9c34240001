"""The model card of a shared run: README.md with a head in YAML, as the Hugging Face Hub reads it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pfnn_jax.models.network import num_parameters
from pfnn_jax.run import Run
from pfnn_jax.workflows.style_card import is_number

TERMS = ("", "-sa", "-nc", "-nc-sa", "-nd", "-nc-nd")
LICENCES = frozenset(
    ("apache-2.0", "mit", "bsd-2-clause", "bsd-3-clause", "cc0-1.0")
    + tuple(f"cc-by{terms}-{version}" for terms in TERMS for version in ("3.0", "4.0"))
)
"""Identifiers that the Hub knows; the head names any other licence as `other`, with its name."""

PAGE = """\
---
library_name: pfnn_jax
{licence_entries}tags:
- character-animation
- locomotion
- motion-synthesis
- jax
---

# {title}

A network for stylised character locomotion, a run of the Python package pfnn_jax: it walks in the styles below, and
learns another one from a short clip.
{about_data}
- **Network**: layout `{layout}`, {joints} joints, {hidden} hidden units, {experts} parameter sets blended by {gate},
  {parameters:,} parameters; styles of kind `{kind}`
- **Fingerprint of the shared network**: `{fingerprint}`. Styles in files fit if theirs is the same.
- **Licence**: {licence}
- **Written by**: pfnn_jax {version}

## Use

```python
import pfnn_jax as pj

run = pj.workflows.load_run("hf://OWNER/{title}")  # or the folder
walk = pj.workflows.generate_clip(run, {choice}, "figure-eight")
pj.motion.write_bvh("walk.bvh", walk)
```

## Styles

| style | source | frames | recorded speed, m/s | error | licence |
| --- | --- | --- | --- | --- | --- |
{rows}
The error is that of one frame, squared and normalised: 1 is the error of predicting the mean. It is measured on frames
that were held out from learning, if there are any.
"""

ABOUT_DATA = "\nWhat it was trained on, and under which licence, is in [CARD.md](CARD.md).\n"


def model_card(run: Run, title: str, styles: Mapping[str, Mapping[str, Any]], licence: str | None, card: bool) -> str:
    """Returns the text of README.md for a run that is passed on.

    Args:
        run: that is passed on.
        title: of the page.
        styles: what `style.json` records of each style, by name.
        licence: of the whole, if stated.
        card: whether a file CARD.md of the run, on its data and licence, is next to this text.
    """
    network = run.config.network
    return PAGE.format(
        licence_entries=_licence_entries(licence),
        title=_plain(title),
        about_data=ABOUT_DATA if card else "",
        layout=run.config.layout,
        joints=run.config.num_joints,
        hidden=network.hidden,
        experts=network.num_control_points,
        gate="a phase function" if network.phase_size == 0 else "a gating network",
        parameters=num_parameters(run.shared),
        kind=run.config.adapter.kind,
        fingerprint=run.fingerprint,
        licence=_plain(licence) if licence else "not stated",
        version=_plain(run.config.versions.get("pfnn_jax")),
        choice=f'"{next(iter(styles))}"' if styles else "None",
        rows="".join(_row(name, info) for name, info in styles.items()),
    )


def _licence_entries(licence: str | None) -> str:
    """Returns the lines of the head that state a licence."""
    identifier = re.sub("[^a-z0-9.]+", "-", (licence or "").lower()).strip("-.")
    if not identifier:
        return ""
    return f"license: {identifier}\n" if identifier in LICENCES else f'license: other\nlicense_name: "{identifier}"\n'


def _row(name: str, info: Mapping[str, Any]) -> str:
    error = info.get("held_out_error", info.get("error"))
    cells = (name, info.get("source"), info.get("frames"), _number(info.get("speed")), _number(error))
    return f"| {' | '.join(_plain(cell) for cell in (*cells, info.get('licence')))} |\n"


def _number(value: Any) -> str | None:
    return f"{value:.3g}" if is_number(value) else None


def _plain(value: Any) -> str:
    """Returns text that means itself in Markdown, in one line; a dash for nothing."""
    text = "" if value is None else " ".join(str(value).split())
    return re.sub(r"([\\`*\[\]<>|])", r"\\\1", text) or "–"
