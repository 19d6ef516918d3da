"""Real streams on the loopback, of which a test decides what they show."""

from __future__ import annotations

import threading
import time
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
from foxglove.messages import RawImage, Timestamp

LIMIT_S = 60.0


def wait_until(condition) -> None:
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s, "the condition was not met in time"
        time.sleep(0.005)


def make_raw(image, encoding, stamp_s=100.0):
    """The message of an image."""
    rows, cols = image.shape[:2]
    sec, nsec = divmod(round(1e9 * stamp_s), 10**9)
    return RawImage(
        timestamp=Timestamp(sec=sec, nsec=nsec),
        width=cols,
        height=rows,
        encoding=encoding,
        step=image.nbytes // rows,
        data=image.tobytes(),
    )


@contextmanager
def publishing(publish, every_s=0.01):
    """Calls `publish` with 0, 1, ... until the end."""
    ended = threading.Event()

    def run():
        n = 0
        start_s = time.monotonic()
        while not ended.is_set():
            publish(n)
            n += 1
            time.sleep(max(0.0, start_s + n * every_s - time.monotonic()))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def serve_mjpeg(images):
    """A server of one motion-JPEG stream, as a Raspberry Pi runs it; yields (address, its end)."""
    ended = threading.Event()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            if ended.is_set():
                self.send_error(503)
                return
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            n = 0
            while not ended.is_set():
                image = images[n % len(images)]
                _, jpeg = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])
                head = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(
                    jpeg
                )
                try:
                    self.wfile.write(head + jpeg.tobytes() + b"\r\n")
                except OSError:
                    return
                n += 1
                time.sleep(0.01)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/?action=stream", ended
    finally:
        ended.set()
        server.shutdown()
        server.server_close()


def make_coloured(shape, grey=120):
    """A picture whose red, green and blue differ."""
    image = np.zeros((*shape, 3), np.uint8)
    image[..., 0] = grey
    image[..., 1] = grey // 2
    image[..., 2] = 200
    image[::7, ::5] = 90
    return image
