"""What an engine programmer ports: the loop of an exported character, in NumPy alone, on a folder of `pfnn-jax export`.

Read in this order: `ground` (complex numbers on the ground), `network` (evaluates it), `loop` (the published loop),
`tracking` (follows commands), `body` and `foot_lock` (rigid bones, feet on the ground), `character` (all of it),
`handedness` (axes of engines). Constants stand in description.json. `pfnn-jax export` puts a copy of this folder into
every export:

    character = Character("exported", style="old")
    character.step(1.2 + 0j, 1 + 0j)  # 60 times a second: 1.2 m/s along +Z, facing +Z
    character.hips, character.local_rotations  # to the rig
"""

from .character import Character, load
from .loop import PublishedLoop
from .network import load_network

__all__ = ["Character", "PublishedLoop", "load", "load_network"]
