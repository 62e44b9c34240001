"""Pretraining, few-shot learning and generator tuning in memory: rows in, parameters out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
