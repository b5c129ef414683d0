"""The camera's picture as live H.264: for ground stations by RTP and RTSP, and for the cockpit."""
