"""Everything about touch translation that can be known without a screen."""

__version__ = "0.1.0"

import os

# Most pixels of an image that OpenCV decodes: twice those of the largest camera in a tactile sensor, since a dozen are
# held at once. It reads the limit once, when it is loaded.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 24))
