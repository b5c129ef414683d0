"""The smallest scenarios that are worth a flight."""


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


NEAR_CAR = """
name: near
title: A car is nearer than the wanted distance.
duration_s: 14
targets:
  - {kind: car, colour: "#e0401c", path: {points: [[12, 0], [13, 0]]}}
camera: {width: 320, height: 240}
start: {at: [0, 0]}
select: {colour: "#e0401c"}
follow: {servo: {distance_m: 20, target_size_m: 2.2, hold_height: true}}
"""
