"""Expectations of quantities that have to be measured, in scenes of every kind but deformable bodies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from femdeform.scene.key_path import KeyPath
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean


class _Measuring(Protocol):
    """A scene with `measure` and `expect`."""

    @property
    def measure(self) -> Mapping[str, Any]:
        """Quantities by name."""

    @property
    def expect(self) -> Any:
        """Expected values."""


def unmeasured_findings(scene: _Measuring) -> Iterator[Finding]:
    """Expectations of quantities that the scene does not measure."""
    wanted: list[tuple[KeyPath, str]] = [(("expect", "measured", name), name) for name in scene.expect.measured]
    for index, crossing in enumerate(scene.expect.time_to_reach):
        wanted.append((("expect", "time_to_reach", index, "quantity"), crossing.quantity))
    for path, name in wanted:
        if name not in scene.measure:
            yield Finding(path, f"`{name}` is not measured; {did_you_mean(name, scene.measure)}")
