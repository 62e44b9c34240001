"""Words for the parts of the body, of the naming conventions in use."""

from __future__ import annotations

import re

from pfnn_jax.motion.humanoid.names import JointName

CLEAR, LIKELY, POSSIBLE, WEAK = 4.0, 3.0, 2.0, 1.0
"""Points of a word that is used for one part only, for this part mostly, for another part mostly, or for any part."""

_CLEAR_WORDS = {
    "clavicle": "clavicle collar collarbone scapula schlusselbein schluesselbein clavicule clavicula clavicola",
    "upper_arm": "upperarm uparm uarm armupper humerus shldr bicep oberarm",
    "lower_arm": "forearm lowerarm lowarm loarm farm armlower elbow radius unterarm ellbogen ellenbogen avantbras "
    "coude antebrazo codo avambraccio gomito antebraco cotovelo",
    "hand": "hand wrist handgelenk poignet mano muneca polso mao pulso",
    "thigh": "upleg upperleg thigh femur legupper oberschenkel cuisse muslo coscia coxa",
    "shin": "lowerleg lowleg loleg leglower shin calf knee tibia unterschenkel knie genou mollet rodilla pantorrilla "
    "ginocchio polpaccio joelho canela",
    "foot": "ankle feet talus knochel knoechel cheville tobillo caviglia tornozelo",
    "toe": "toebase toe toes ball zeh zehe zehen orteil orteils",
}
_AMBIGUOUS_WORDS = {
    "shoulder": {"clavicle": LIKELY, "upper_arm": POSSIBLE},
    "arm": {"upper_arm": LIKELY, "lower_arm": WEAK, "hand": WEAK},
    "fist": {"hand": LIKELY},
    "palm": {"hand": LIKELY},
    "hip": {"thigh": LIKELY},
    "leg": {"shin": LIKELY, "thigh": POSSIBLE, "foot": WEAK, "toe": WEAK},
    "foot": {"foot": CLEAR, "toe": POSSIBLE},
}
_SAME_AS = {
    "shoulder": "schulter epaule hombro spalla ombro",
    "arm": "bras brazo braccio braco",
    "fist": "main",
    "hip": "hufte huefte hanche cadera anca quadril",
    "leg": "bein jambe pierna gamba perna",
    "foot": "fuss pied pie piede pe",
}
"""Words of German, French, Spanish, Italian and Portuguese, without accents, that mean as little or as much."""
LIMB_WORDS: dict[str, dict[str, float]] = {
    **{word: {part: CLEAR} for part, words in _CLEAR_WORDS.items() for word in words.split()},
    **_AMBIGUOUS_WORDS,
    **{word: _AMBIGUOUS_WORDS[same] for same, words in _SAME_AS.items() for word in words.split()},
}
"""Word of a joint with a side -> part of a limb -> points."""

LEVEL = re.compile(r"^(lower|upper)|(lower|upper)$")
HIPS_WORDS = frozenset("hips pelvis hip hufte huefte becken hanches bassin cadera caderas anca bacino quadril".split())
HEAD_WORDS = frozenset("head skull kopf tete cabeza testa cabeca".split())
NECK_WORDS = frozenset("neck necktwist hals nacken cou cuello collo pescoco".split())
SPINE_WORDS = frozenset(
    "spine chest abdomen ab torso waist back belly tummy body ribs ribcage thorax stomach "
    "wirbelsaule wirbelsaeule rucken ruecken brust bauch colonne dos poitrine torse ventre columna espalda pecho "
    "colonna schiena petto torace coluna peito costas".split()
)
"""Words of joints without a side, with or without lower and upper."""


def limb_points(name: JointName) -> dict[str, float]:
    """Returns part of a limb -> points that a joint's name gives it; empty for helpers and other joints."""
    return LIMB_WORDS.get(name.part, {}) if name.side and not name.helper else {}


def trunk_part(name: JointName) -> str:
    """Returns `hips`, `spine`, `neck` or `head` for a joint on the midline that is called so, else an empty text."""
    if name.side or name.helper:
        return ""
    word = LEVEL.sub("", name.part)
    for part, words in (("hips", HIPS_WORDS), ("head", HEAD_WORDS), ("neck", NECK_WORDS), ("spine", SPINE_WORDS)):
        if word in words:
            return part
    return ""
