"""Everything about touch translation that can be known without a screen."""

__version__ = "0.1.0"

import os

# Most pixels of an image that OpenCV decodes: it reads the limit once, when it is loaded.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 26))
