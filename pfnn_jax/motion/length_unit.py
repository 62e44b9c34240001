"""The unit of a file's lengths, guessed from the length of a leg by how likely a person of that size is."""

from __future__ import annotations

import math
from typing import Literal

METRE, DECIMETRE, CENTIMETRE, MILLIMETRE, INCH, FOOT, CMU = 1.0, 0.1, 0.01, 0.001, 0.0254, 0.3048, 0.056444

UnitName = Literal["metre", "decimetre", "centimetre", "millimetre", "inch", "foot", "CMU"]

UNITS: dict[str, float] = {
    "metre": METRE,
    "decimetre": DECIMETRE,
    "centimetre": CENTIMETRE,
    "millimetre": MILLIMETRE,
    "inch": INCH,
    "foot": FOOT,
    "CMU": CMU,
}
"""Metres per unit; CMU is the unit of the CMU motion capture database."""

# Legs from hip to ankle: 0.85 m in most adults, who vary by 8 %, and 0.6 m in children, who vary by 25 %.
PEOPLE = ((0.9, 0.85, 0.08), (0.1, 0.6, 0.25))
"""Share, median leg in metres and standard deviation of its logarithm, of adults and of children."""

USUAL_LEG = (0.35, 1.15)
"""Metres; a leg outside is worth a note."""

POSSIBLE_LEG = (0.2, 2.0)
"""Metres; a leg outside means that the unit is wrong."""

DOUBTFUL = 20.0
"""Ratio of likelihoods up to which another unit is named next to the guess."""


def unit_name(unit: float) -> str:
    """Returns the name of a unit of `UNITS`, or its length in metres."""
    names = [name for name, length in UNITS.items() if math.isclose(length, unit, rel_tol=1e-6)]
    return names[0] if names else f"{unit:g} m"


def log_likelihoods(leg: float) -> dict[str, float]:
    """Returns, for every unit, the logarithm of how likely a person's leg has this length.

    Args:
        leg: from hip to ankle, in the file's unit; above zero.
    """
    return {name: _log_density(math.log(leg * unit)) for name, unit in UNITS.items()}


def guess_unit(leg: float) -> tuple[float, str]:
    """Guesses the metres per unit of a file.

    Args:
        leg: from hip to ankle, in the file's unit; a leg of length zero gives metres.

    Returns:
        The unit, and a note that names another unit if that is nearly as likely; empty if none is.
    """
    if not leg > 0:
        return METRE, ""
    likely = log_likelihoods(leg)
    first, second = sorted(likely, key=lambda name: -likely[name])[:2]
    if likely[first] - likely[second] > math.log(DOUBTFUL):
        return UNITS[first], ""
    sizes = f"legs of {leg * UNITS[first]:.2f} m; {second} would give {leg * UNITS[second]:.2f} m"
    return UNITS[first], f"the unit is taken to be {first}, {sizes}: pass `--unit` if that is right"


def _log_density(log_leg: float) -> float:
    """Returns the log density of a mixture of two log-normal distributions, stable far from both."""
    terms = [
        math.log(share / spread) - 0.5 * ((log_leg - math.log(median)) / spread) ** 2
        for share, median, spread in PEOPLE
    ]
    most = max(terms)
    return most + math.log(sum(math.exp(term - most) for term in terms))
