"""The body that is drawn wherever a skeleton has no mesh of its own: a mannequin grown from its joints."""

from pfnn_jax.viewer.body.grow import grow_body

__all__ = ["grow_body"]
