"""Settings: frozen, validated, and saved with every result. The paper's values are `PaperSettings()`."""

from mien.config.paper import PaperSettings
from mien.config.realtime import RealtimeSettings
from mien.config.settings import DescriptorSettings, Settings, given_or_default, read_settings

__all__ = [
    "DescriptorSettings",
    "PaperSettings",
    "RealtimeSettings",
    "Settings",
    "given_or_default",
    "read_settings",
]
