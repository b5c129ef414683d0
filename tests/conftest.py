"""What holds for all tests."""

from hypothesis import settings

# How long an example takes says nothing here: the computer may be shared.
settings.register_profile("shared computer", deadline=None)
settings.load_profile("shared computer")
