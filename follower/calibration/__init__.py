"""A camera's focal length, centre and distortion from pictures of a printed board."""
