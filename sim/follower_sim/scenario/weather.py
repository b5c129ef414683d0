"""How weather, light and lens spoil a camera's pictures, as a scenario says it; 0 is not at all."""

from dataclasses import dataclass

from follower_control.common.strict_config import check_ranges


@dataclass(frozen=True, slots=True)
class WeatherSettings:
    """What is in the air between the camera and the world.

    Attributes:
        fog_per_m: extinction coefficient of the fog: of the light exp(-fog_per_m × metres) gets
            through. What is black is seen as far as 3.9 / fog_per_m (Koschmieder).
        rain_mm_h: rate of the rain; 2.5 is light, 10 moderate, 50 violent.
    """

    fog_per_m: float = 0.0
    rain_mm_h: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self, fog_per_m=(0, 1), rain_mm_h=(0, 200))

    @property
    def extinction_per_m(self) -> float:
        """Extinction coefficient of fog and rain together (rain's: Atlas, 1953)."""
        return float(self.fog_per_m + 0.312e-3 * self.rain_mm_h**0.67)


@dataclass(frozen=True, slots=True)
class LowLightSettings:
    """A sensor that gets little light, and what it makes of it.

    Attributes:
        stops: how many times the light of a day is halved.
        gain_stops: so many of them the camera makes up for, with as much more noise; what is
            beyond makes the picture darker. Exposures are made longer by `exposure_s` alone.
        full_well_e: electrons of a white pixel by day.
        read_noise_e: standard deviation of the reading, in electrons.
    """

    stops: float = 0.0
    gain_stops: float = 5.0
    full_well_e: float = 10_000.0
    read_noise_e: float = 3.0

    def __post_init__(self) -> None:
        check_ranges(self, stops=(0, 14), gain_stops=(0, 14))
        check_ranges(self, full_well_e=(100, 1e6), read_noise_e=(0, 1000))
