"""Cameras, streams, video files and image folders as sources of frames.

Uses: `images`, OpenCV, PyAV.
Start at: `frame_source.FrameSource`, then `open.open_source`.
"""
