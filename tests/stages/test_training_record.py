"""What a training's record says that somebody else wrote: told in one short line."""

from __future__ import annotations

import pytest

from telewide.errors import UsageError
from telewide.stages.training_record import TrainingRecord, refuse_another_recipe


def test_a_recipe_of_thousands_of_other_keys_is_refused_in_one_line() -> None:
    strange = {f"key{number}\nerror: all is lost": {"x" * 1000: 1} for number in range(5000)}
    kept = TrainingRecord(recipe=strange, window=(0, 64), captures=(), held_out=())
    with pytest.raises(UsageError, match="and 4988 more") as caught:
        refuse_another_recipe(kept, {}, anew="telewide train --fresh")
    assert "\n" not in caught.value.message
    assert len(caught.value.message) < 2000
