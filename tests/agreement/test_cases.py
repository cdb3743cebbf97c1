"""The coarse end of every verification case, by the function that `femdeform verify` uses."""

from __future__ import annotations

import pytest

from verification.case import shipped_cases
from verification.study import run_case


@pytest.mark.parametrize("name", shipped_cases())
def test_every_judgement_lies_inside_its_band(name: str) -> None:
    result = run_case(shipped_cases()[name])
    print(f"{name}: {len(result.verdicts)} judgements in {result.seconds:.1f} s")
    assert result.verdicts
    failed = [f"{v.study}, {v.quantity}, {v.level}: {v.reason}" for v in result.verdicts if not v.passed]
    assert not failed, "\n".join(failed)
