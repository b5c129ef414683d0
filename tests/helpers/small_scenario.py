"""The smallest scenario that is worth a flight."""


def small_scenario(duration_s: float, takeoff_height_m: float = 4) -> str:
    """Return its YAML; the name is "small"."""
    return f"""
name: small
title: A car stands in a meadow.
duration_s: {duration_s}
seed: 5
targets:
  - {{kind: car, colour: "#e0401c", path: {{points: [[15, 0], [25, 0]]}}}}
camera: {{width: 320, height: 240, exposure_s: 0.0}}
takeoff_height_m: {takeoff_height_m}
start: {{at: [0, 0]}}
select: {{colour: "#e0401c"}}
"""
