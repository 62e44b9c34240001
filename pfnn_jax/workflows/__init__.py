"""Work on folders: runs are pretrained, loaded, given new styles, used to generate clips, imported and exported."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
