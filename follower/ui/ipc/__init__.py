"""The flight's end of the UI process: what is sent to it, and what operators ask for.

Uses: `flight`; shared memory and a socket.
Start at: `server_client.UiProcessClient`.

Video and web pages are work, and their libraries are large: none of that is to slow down, or take
down with it, the process that steers a vehicle.
"""
