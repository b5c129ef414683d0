"""Generated scenes in which nothing is hard: what a tiny network learns from in a test."""

from follower.training.scenes.generator import SceneSettings

EASY = SceneSettings(
    least_scale=40,
    most_scale=60,
    motion=0.1,
    perspective=0.0,
    deformation=0.0,
    occlusion=0.0,
    look_alikes=0.0,
    leaving=0.0,
    blur=0.0,
    low_light=0.0,
    pieces=0.0,
    loose=0.0,
)
