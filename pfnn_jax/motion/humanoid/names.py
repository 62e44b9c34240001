"""Reads joint names: removes what exporters add, and divides the rest into side, part and number."""

from __future__ import annotations

import functools
import re
from collections import Counter
from dataclasses import dataclass

from pfnn_jax.motion.humanoid.languages import in_english

_SIDES = {
    "left": "left l lft lt links linke linker linkes gauche izquierda izquierdo izq sinistra sinistro sx esquerda "
    "esquerdo",
    "right": "right r rgt rt rechts rechte rechter rechtes droite droit derecha derecho der destra destro dx direita "
    "direito",
}
SIDE_WORDS = {word: side for side, words in _SIDES.items() for word in words.split()}
SIDE_LETTERS = (("l", "r", "left"), ("r", "l", "right"), ("g", "d", "left"), ("d", "g", "right"))
"""Letter of a side that begins or ends a name, that of the other side, and the side; g and d are French."""

OTHER_SIDE = {"left": "right", "right": "left", "": ""}

SHARED = 0.5
"""Share of the joints of which more must begin with the same word for it to be a prefix of the exporter."""

FILLER = frozenset(
    "jnt jt joint bone bn b bind def deform org fk armature skeleton rig bip biped valve valvebiped character skin m x "
    "bend stretch".split()
)
"""Words that say nothing about the part of the body."""

HELPER_WORDS = frozenset("ik end tip nub site mch pt roll leaf tweak con ctrl null dummy slot socket".split())
HELPER_PARTS = re.compile("twist|pole|target|control|helper|rigmesh|effector|orient|tracker|hipjoint")
"""Words, and parts of words, of joints that help to animate, to skin or to end a bone."""


WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
"""A word or a number within a name."""

PREFIX = re.compile(r"mixamorig|[A-Za-z]+\d*[ _.:-](?=[\w ])|[a-z]{4,}(?=[A-Z])|[A-Z]{2,}_")
"""A word and its number at the beginning of a name, up to a separator or to a capital letter as in mixamorigHips."""

COUNTED, GLUED = re.compile(r"(.+)_(\d+)"), re.compile(r"(left|right)(.+)")
"""A name with a counter, and a name that begins with its side."""

VERTEBRA = re.compile(r"l[1-5]|t([1-9]|1[0-2])|c[1-7]")
"""Names of vertebrae, as in captures by Xsens, which have several."""


@dataclass(frozen=True)
class JointName:
    """What the name of a joint says.

    Attributes:
        side: `left`, `right` or empty.
        part: the words in lower case and joined, without side, numbers and filler: `upleg`.
        numbers: in the name, in order, without leading zeros; as text, since names may hold thousands of digits.
        helper: whether the name is that of a twist, helper, control or leaf joint.
    """

    side: str
    part: str
    numbers: tuple[str, ...]
    helper: bool


@functools.lru_cache(maxsize=64)
def plain_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Returns joint names without namespaces (`mixamorig:`), shared prefixes (`Bip01 `) and exporter suffixes (`_12`).

    A suffix is removed only where every joint has one and no two have the same, apart from an added root.
    """
    plain = [name[max(name.rfind(":"), name.rfind("|")) + 1 :] or name for name in names]
    numbered = [COUNTED.fullmatch(name) for name in plain]
    counters = [match[2] if match else "" for match in numbered]
    if all(counter or "root" in name.lower() for counter, name in zip(counters, plain, strict=True)) and (
        len(set(counters)) == len(counters) > 1
    ):
        plain = [match[1] if match else name for name, match in zip(plain, numbered, strict=True)]
    while prefix := _shared_prefix(plain):
        plain = [name[len(prefix) :] if name.startswith(prefix) and len(name) > len(prefix) else name for name in plain]
    return tuple(plain)


def _shared_prefix(names: list[str]) -> str:
    """Returns the first word of most names with the separator behind it; empty where no word is a prefix."""
    matches = (PREFIX.match(name) for name in names)
    counts = Counter(match[0] for match in matches if match)
    if not counts:
        return ""
    prefix = max(counts, key=counts.__getitem__)
    word, count = "".join(letter for letter in prefix.lower() if "a" <= letter <= "z"), counts[prefix]
    return prefix if count > max(SHARED * len(names), 2) and word not in SIDE_WORDS else ""


def words_of(name: str) -> list[str]:
    """Splits a name of any script into lower-case words and numbers: `LeftUpLeg2` -> left, up, leg, 2."""
    return [word.lower() for word in WORD.findall(in_english(name))]


@functools.lru_cache(maxsize=64)
def read_names(names: tuple[str, ...]) -> tuple[JointName, ...]:
    """Returns side, part and number of each joint's name."""
    plain = plain_names(names)
    words = [words_of(name) for name in plain]
    whole = {"".join(w) for w in words}
    return tuple(_read(name, w, whole) for name, w in zip(plain, words, strict=True))


def _read(name: str, words: list[str], whole: set[str]) -> JointName:
    """Returns what a name says.

    Args:
        name: without prefixes and suffixes.
        words: of the name.
        whole: all names of the skeleton, as joined words.
    """
    joined = "".join(words)
    helper = name.startswith("__") or not HELPER_WORDS.isdisjoint(words) or bool(HELPER_PARTS.search(joined))
    if "necktwist" in joined and not any(word.startswith("neck") and "twist" not in word for word in whole):
        helper = False  # the neck itself of Character Creator
    side, rest = _split_side(words, whole)
    part = "".join(word for word in rest if not word.isdigit() and word not in FILLER)
    if VERTEBRA.fullmatch(joined) and len([word for word in whole if VERTEBRA.fullmatch(word)]) > 2:
        part = "neck" if part == "c" else "spine"
    return JointName(side, part, tuple(word.lstrip("0") for word in rest if word.isdigit()), helper)


def _split_side(words: list[str], whole: set[str]) -> tuple[str, list[str]]:
    """Returns the side that a name's words mean, and the other words."""
    for at, word in enumerate(words):
        rest = words[:at] + words[at + 1 :]
        if word in SIDE_WORDS and any(not other.isdigit() for other in rest):
            return SIDE_WORDS[word], rest
    joined = "".join(words)
    if glued := GLUED.match(joined):
        return glued[1], [glued[2]]
    for mark, other, side in SIDE_LETTERS:
        if joined[:1] == mark and other + joined[1:] in whole:
            return side, WORD.findall(joined[1:])  # lfemur, where there is also rfemur
        if joined[-1:] == mark and joined[:-1] + other in whole:
            return side, WORD.findall(joined[:-1])
    return "", words


def natural_order(name: str) -> tuple:
    """Returns a key that sorts names by their numbers, toe2 before toe10, and then by their letters."""
    numbers = (word.lstrip("0") for word in re.findall(r"[0-9]+", name))
    return tuple((len(number), number) for number in numbers), name
