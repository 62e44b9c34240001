"""Stylised character locomotion from short clips.

The public names live in six namespaces: `motion`, `models`, `training`, `control`, `workflows` and `viewer`. Each is
imported when it is first used, so that reading motion does not wait for JAX. The `.pyi` file next to a namespace lists
its names, for Python as well as for editors and type checkers.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__all__ += ["__version__"]
