"""Everything about touch translation that can be known without a screen."""

import os

__version__ = "0.1.0"

# Numba imports the first of these with the first kernel; the others are its own, for whatever else is compiled.
os.environ.setdefault(
    "NUMBA_CACHE_LOCATOR_CLASSES",
    "pipeline.base.kept_kernels.Place,UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator",
)
