"""Where the configuration files and scenarios are: in a wheel or in a checkout."""

from pathlib import Path

from follower_control.common.strict_config import SettingsError


def configs_folder() -> Path:
    """Return the folder with the files of `configs/`."""
    installed = Path(__file__).parents[1] / "_configs"
    return installed if installed.is_dir() else Path(__file__).parents[2] / "configs"


def scenario_files() -> dict[str, Path]:
    """Return the scenarios that come with the project, by name."""
    return {path.stem: path for path in sorted((configs_folder() / "scenarios").glob("*.yaml"))}


def find_scenario(text: str) -> Path:
    """Return the file of a scenario given by its path or by the name of one that comes along.

    Raises:
        SettingsError: there is neither.
    """
    path = Path(text)
    if path.suffix in (".yaml", ".yml") or path.is_file():
        return path
    known = scenario_files()
    if text not in known:
        raise SettingsError(
            f"there is no scenario {text!r}: give a YAML file, or one of {', '.join(known)}"
        )
    return known[text]
