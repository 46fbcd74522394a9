"""What all settings have in common: they are frozen, validated, saved with every result, and read from JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mien.errors import MienError, require


class Settings(BaseModel):
    """A frozen set of settings; unknown names and invalid values are rejected by name."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, values: Any) -> Any:
        """Complete settings within these, of which only some are given, by those that are the default here."""
        if not isinstance(values, dict):
            return values
        own = {name: field.default for name, field in cls.model_fields.items() if isinstance(field.default, Settings)}
        given = {name: values[name] for name in own if isinstance(values.get(name), dict)}
        return values | {name: own[name].model_dump() | given[name] for name in given}


class DescriptorSettings(Settings):
    """How descriptors are computed, in a crop in which the face has a fixed size.

    pixels_per_unit: size of a CANDIDE unit in the crop, in pixels; cell: side of one of SIFT's 4x4 cells, in
    pixels of the crop; blur: standard deviation, in pixels, of a Gaussian applied first; root: 0 clips the entries as
    Lowe does, a positive value is added to them before their square root is taken (kernel `mien` only).
    """

    kernel: Literal["mien", "opencv"] = "mien"
    pixels_per_unit: float = Field(64.0, ge=8, le=1024)
    cell: int = Field(6, ge=1, le=256)
    blur: float = Field(1.0, ge=0)
    root: float = Field(0.0, ge=0)

    @property
    def reach(self) -> int:
        """How far the cells extend to each side of a point, in pixels of the crop."""
        return 2 * self.cell


SomeSettings = TypeVar("SomeSettings", bound=Settings)


def given_or_default(settings: SomeSettings | None, kind: type[SomeSettings]) -> SomeSettings:
    """The settings that a tracker is given, by default those of its kind. Raises MienError for any others."""
    require(
        settings is None or isinstance(settings, kind),
        f"the settings are {type(settings)}; give mien.config.{kind.__name__}, or omit them",
    )
    return kind() if settings is None else settings


def read_settings(path: Path, kind: type[SomeSettings]) -> SomeSettings:
    """Read settings of one kind from a JSON file: either the values that differ from the defaults, keyed by name, or
    the NAME.json of a track.

    Raises MienError naming the file if it cannot be read, or has an unknown setting or an invalid value.
    """
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); give a JSON file with settings") from error
    except ValueError as error:
        raise MienError(
            f"{path} is not valid JSON ({error}); give a file like the NAME.json that mien writes"
        ) from error
    values = _settings_in(values, kind, path) if isinstance(values, dict) else None
    example = json.dumps(_last(kind().model_dump()))
    require(isinstance(values, dict), f"{path} holds no settings keyed by name; give JSON like {example}")
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(map(str, first["loc"]))
        wrong = _WRONG.get(first["type"], first["msg"].lower())
        raise MienError(f"{path}: {name}: {wrong}; mien.config.{kind.__name__} lists them all") from error


_WRONG = {"extra_forbidden": "unknown setting", "model_type": "input should be settings keyed by name"}
"""What is said of a value by the type of its error, where pydantic speaks of what its user does not know."""


def _settings_in(values: dict[str, Any], kind: type[Settings], path: Path) -> Any:
    """The settings in the content of a file. Raises MienError if some stand beside those of a track, where they would
    be ignored."""
    if "settings" not in values:
        return values
    groups = {name for name, field in kind.model_fields.items() if isinstance(field.default, Settings)}
    beside = ", ".join(sorted(groups & set(values)))
    require(not beside, f"{path}: {beside}: stands beside `settings` and would be ignored; move it into them")
    return values["settings"]


def _last(values: dict[str, Any]) -> dict[str, Any]:
    """The last value, with its name; of one that is a group itself only the last likewise."""
    name, value = list(values.items())[-1]
    return {name: _last(value) if isinstance(value, dict) else value}
