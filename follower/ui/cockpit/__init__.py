"""A web page to watch a flight, choose its target, change its gains and stop it.

Uses: `ui.ipc`, `ui.video`; FastAPI in its own process only.
Start at: `process`, then `server.CockpitServer`.
"""
