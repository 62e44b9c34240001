"""Motion clips: skeletons, BVH files, labels, features, data sets and procedural walks. NumPy only."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
