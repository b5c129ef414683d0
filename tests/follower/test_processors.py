"""Control computes the same bits whichever code NumPy's linear algebra would choose."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from follower.recording.config import processor_features

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
KERNELS = {
    "Prescott": {"SSE3", "X86_V2"},
    "Haswell": {"AVX2", "X86_V3"},
    "SkylakeX": {"AVX512_SKX", "X86_V4"},
}
"""OpenBLAS' kernels, and NumPy's names, old and new, for what the processor needs for them."""


def computed(kernel: str) -> tuple[str, list[str]]:
    """The kernels that were used, by OpenBLAS' own word, and digests of what came out."""
    result = subprocess.run(
        [sys.executable, str(HERE / "fly_and_replay.py"), str(HERE.parent / "golden" / "chase")],
        env={**os.environ, "OPENBLAS_CORETYPE": kernel},
        capture_output=True,
        text=True,
        check=True,
    )
    used, *digests = result.stdout.splitlines()
    return used, digests


def test_flights_are_the_same_bits_with_every_kernel_of_openblas() -> None:
    able = [kernel for kernel, needs in KERNELS.items() if needs & {*processor_features()}]
    if len(able) < 2:
        pytest.skip(f"one kind of OpenBLAS kernel for this processor: {able}")
    used, digests = zip(*(computed(kernel) for kernel in able), strict=True)
    assert len(set(used)) == len(able)
    assert len(digests[0]) == 3
    assert all(one == digests[0] for one in digests)
