"""What all trainings in tests share: one thread of torch, and procedural pictures."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from follower.training.scenes.image_source import ImageSource, procedural


@pytest.fixture(autouse=True, scope="module")
def _one_thread() -> Iterator[None]:
    """Torch's own threads only wait for each other with networks as small as these."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def pictures() -> ImageSource:
    return procedural(np.random.default_rng(3), 6)
