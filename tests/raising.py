"""Asserts the fields of an `InputError` instead of its wording."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfnn_jax.errors import InputError


def assert_refused(
    call: Callable[[], Any],
    *,
    file: str | Path | None = None,
    place: str | None = None,
    value: object = None,
    rule_mentions: str | None = None,
) -> InputError:
    """Asserts that a call raises an `InputError` with the given fields.

    Args:
        call: function without arguments.
        file: how the error's file ends.
        place, value: as in the error; values are compared as text.
        rule_mentions: text that the rule contains.

    Returns:
        The error, for further checks.
    """
    with pytest.raises(InputError) as caught:
        call()
    error = caught.value
    assert file is None or error.file.endswith(str(file)), error
    assert place is None or error.place == place, error
    assert value is None or str(error.value) == str(value), error
    assert rule_mentions is None or rule_mentions in error.rule, error
    return error
