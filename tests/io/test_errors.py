"""Messages of errors are one readable line, whatever a file holds."""

from __future__ import annotations

import pickle

from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.errors import LONGEST_PART, LONGEST_RULE, InputError

TEXTS = st.one_of(
    st.text(st.characters(exclude_categories=())),  # surrogates too, which JSON can state
    st.builds(lambda letter, times: letter * times, st.characters(exclude_categories=()), st.integers(0, 20_000)),
)


@given(TEXTS, TEXTS, st.one_of(TEXTS, st.integers(), st.lists(st.integers())), TEXTS)
def test_messages_are_one_readable_line_of_bounded_length(file, place, value, rule):
    message = str(InputError(file, place, value, rule))
    assert message.isprintable()
    assert len(message) <= 2 * (LONGEST_PART + LONGEST_RULE) + len(": : ; ")
    message.encode()


@given(st.text(st.characters(categories=("L", "N", "P")), max_size=LONGEST_PART), st.integers())
def test_short_printable_parts_are_shown_as_they_are(place, value):
    assert str(InputError("a.bvh", place, value, "must be small")) == f"a.bvh: {place}: {value}; must be small"


def test_long_values_show_both_ends_and_are_kept_whole():
    value = "begin" + "9" * 5000 + "end"
    error = InputError("a.json", "size", value, "must be small")
    assert "begin9" in str(error) and "9end; must be small" in str(error)
    assert error.value == value
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
