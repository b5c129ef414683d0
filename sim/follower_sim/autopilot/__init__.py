"""An autopilot that speaks MAVLink with the modes, time-outs and frames of PX4 and ArduCopter.

Uses: `vehicle`, pymavlink.
Start at: `autopilot.SimAutopilot`.
"""
