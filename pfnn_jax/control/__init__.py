"""Control of a character: the interactive controller, walks along paths and inverse kinematics."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
