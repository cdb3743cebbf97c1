"""A small scene to compare on, and solvers that misbehave in a known way."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scenario import block, body, material, quasistatic, scene, write

from femdeform import registry
from femdeform.step_problem import StepResult
from solvers.projected_newton import ProjectedNewton

# max_iterations of a variant that is to misbehave: the scene's own options tell the solvers apart.
NAN_ITERATE, NAN_RESULT, LIAR, STUBBORN, INSIDE_OUT, FAR_OFF = 41, 42, 43, 44, 45, 46
MISBEHAVIOUR = {
    "nan": f"solver.max_iterations={NAN_ITERATE}",
    "nan at the end": f"solver.max_iterations={NAN_RESULT}",
    "liar": f"solver.max_iterations={LIAR}",
    "stubborn": f"solver.max_iterations={STUBBORN}",
    "inside out": f"solver.max_iterations={INSIDE_OUT}",
    "far off": f"solver.max_iterations={FAR_OFF}",
}


def bar(*conditions: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A clamped plane bar, bent by a load on its free end."""
    load = {"kind": "traction", "on": "b.right", "value": [0.0, -2e3]}
    held = {"kind": "fixed", "on": "b.left"}
    data = {"solver": {"tolerance": 1e-12}, "time": quasistatic(dt=0.25), **more}
    return scene({"b": body(block([1.0, 0.2], [6, 2]), material(E=1e5))}, held, *(conditions or (load,)), **data)


def write_bar(folder: Path, *conditions: dict[str, Any], **more: Any) -> Path:
    """The bar as a file."""
    return write(bar(*conditions, **more), folder / "bar.yaml")


class Misbehaving(ProjectedNewton):
    """Projected Newton, but for the options above."""

    def step(self, problem: Any, state: Any, observe: Any = None, budget: Any = None) -> StepResult:
        kind = self.options.max_iterations
        if kind == NAN_ITERATE and state.step >= 1:
            x = problem.initial_guess(state)
            for iteration in range(1, 100):
                if iteration == 3:
                    x = x * np.nan
                if observe is not None:
                    observe({"iteration": iteration}, x)
            raise AssertionError("somebody should have stopped this")
        result = super().step(problem, state, observe, budget)
        if kind == NAN_RESULT:
            return replace(result, x=result.x * np.nan)
        if kind == INSIDE_OUT:
            return replace(result, x=result.x * [1.0, -1.0])
        if kind == FAR_OFF:
            return replace(result, x=result.x * 100.0)
        if kind == LIAR:
            return replace(result, residual_norm=0.5 * result.residual_norm, converged=True, reason="all is well")
        if kind == STUBBORN:
            return replace(result, converged=False, reason="the line search failed")
        return result


def let_misbehave(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put `Misbehaving` in the place of projected Newton."""
    module = ModuleType("misbehaving_solvers")
    module.Misbehaving = Misbehaving  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    monkeypatch.setitem(registry.SOLVERS, "projected_newton", "misbehaving_solvers:Misbehaving")
