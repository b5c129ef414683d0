"""Training of the project's own networks; the only package that imports torch.

Uses: `follower_vision`, `follower_sim`'s renderer.
Start at: `command`.
"""

import follower_vision  # noqa: F401  (before onnxruntime, whose reports it switches off)
