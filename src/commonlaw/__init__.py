"""commonlaw finds the law that repeated, noisy experiments on several objects have in common.

Each public name is loaded when it is first used, so that importing the package costs next to nothing; `__init__.pyi`
lists them.
"""

import warnings

import lazy_loader

__version__ = "0.2.0"

_loaded, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RENAMED = {"FamilyLibrary": "ParametricLibrary"}
"""Public names of the last release that have others now."""


def __getattr__(name: str) -> object:
    if name in RENAMED:
        warnings.warn(f"{name} is called {RENAMED[name]} now", DeprecationWarning, stacklevel=2)
    return _loaded(RENAMED.get(name, name))
