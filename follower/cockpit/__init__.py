"""A web page to watch a flight, choose its target, change its gains and stop it."""
