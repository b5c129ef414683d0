"""A world, a camera and an autopilot to fly against.

Uses: `follower_control`, `follower_vision`.
Start at: `scenario.scenario.Scenario`, then `world.world`, `autopilot.autopilot.SimAutopilot`.
"""
