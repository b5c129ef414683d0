"""A follow mode that lets the target come near: `--set servo.mode=leash`."""

from dataclasses import replace

from follower_control.servo.servo import ServoStep, VisualServo
from follower_control.vehicle.setpoint import VelocitySetpoint


def make(servo: VisualServo, step: ServoStep) -> VelocitySetpoint:
    """Chase, but never fly backwards; called in every control step, so it has to be quick.

    The envelope limits what it asks for. Where it raises, or gives what is no number, the vehicle
    holds.
    """
    chased = servo.chase(step)
    return replace(chased, forward_m_s=max(chased.forward_m_s, 0.0))
