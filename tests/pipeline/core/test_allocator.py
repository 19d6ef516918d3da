"""Free memory goes back to the system where glibc keeps it in pieces."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from pipeline.core.processes import release_free_memory

CODE = """
import threading
from pathlib import Path
from pipeline.core.processes import limit_arenas, release_free_memory

def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20

assert limit_arenas()
kept = []

def work():
    pieces = [bytearray(60_000) for _ in range(1000)]
    kept.extend(pieces[::100])  # so that no heap can shrink from its end

for _ in range(4):
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
before = resident_mb()
release_free_memory()
assert resident_mb() < before - 30, (before, resident_mb())
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="there is no glibc here")
def test_what_threads_have_let_go_of_goes_back_to_the_system():
    subprocess.run([sys.executable, "-c", CODE], check=True)


def test_it_may_be_asked_anywhere():
    release_free_memory()
