"""Plain data: what YAML and JSON hold before its form is checked."""

from typing import Any, TypeAlias

Fields: TypeAlias = dict[str, Any]
"""Values by key; their form is checked where they are read."""
