"""`follower calibrate`: focal length, centre and distortion from images of a printed board.

Uses: `apps.preflight`, OpenCV.
Start at: `session`.
"""
