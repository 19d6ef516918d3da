"""Everything about touch translation that can be known without a screen."""

__version__ = "0.1.0"

import contextlib
import ctypes
import os

# Most pixels of an image that OpenCV decodes: it reads the limit once, when it is loaded.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))

# glibc would give every freed image back to the system, whose pages cost 2 us each when the next image needs them: it
# keeps 64 MB (M_TRIM_THRESHOLD), and takes arrays up to 32 MB from what it keeps (M_MMAP_THRESHOLD).
with contextlib.suppress(AttributeError, OSError, TypeError):  # other systems
    for _setting, _n_bytes in ((-1, 1 << 26), (-3, 1 << 25)):
        ctypes.CDLL(None).mallopt(_setting, _n_bytes)
