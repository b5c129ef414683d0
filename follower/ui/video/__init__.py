"""The camera's picture as live H.264 by RTP, RTSP and WebRTC.

Uses: PyAV.
Start at: `channel.VideoChannel`.
"""
