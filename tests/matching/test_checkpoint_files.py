"""A checkpoint is looked through before torch opens it: what a few bytes of pickle ask for is not begun."""

from __future__ import annotations

import io
import pickle
from pathlib import Path

import pytest
import torch

from telewide.matching.checkpoint_files import MOST_SHARED_TUPLES, MOST_TUPLES, check_archive, check_pickle
from telewide.training.checkpoint import new_state, save_state


def doubled(levels: int) -> object:
    """A tuple that holds a tuple twice, and so on: 2^levels of them in a few bytes."""
    inner: object = (1,)
    for _ in range(levels):
        inner = (inner, inner)
    return inner


def nested(levels: int) -> bytes:
    """A tuple in a tuple in a tuple: its hash would overflow the stack of Python itself."""
    return b"\x80\x02)" + b"\x85" * levels + b"."


def test_tuples_that_are_named_again_and_again_are_refused() -> None:
    check_pickle(pickle.dumps(doubled(MOST_SHARED_TUPLES), protocol=2))
    with pytest.raises(ValueError, match="17 of them named again"):
        check_pickle(pickle.dumps(doubled(MOST_SHARED_TUPLES + 1), protocol=2))
    # Fetched, and kept under another number.
    renamed = b"\x80\x02)q\0" + b"".join(b"h%cq%c" % (k, k + 1) for k in range(20)) + b"."
    with pytest.raises(ValueError, match="named again"):
        check_pickle(renamed)


def test_tuples_within_tuples_without_end_are_refused() -> None:
    check_pickle(nested(MOST_TUPLES - 1))
    hash(pickle.loads(nested(MOST_TUPLES - 1)))  # what passes can be a key
    with pytest.raises(ValueError, match="32769 tuples"):
        check_pickle(nested(MOST_TUPLES))


@pytest.mark.parametrize("place", ["judgements", "best_stage", "network"])
def test_an_archive_of_such_a_pickle_is_refused_at_once(tmp_path: Path, place: str) -> None:
    content: dict[object, object] = {"judgements": [1.0], "best_stage": 0, "network": {}}
    if place == "network":
        content[place] = {doubled(20): 1}
    else:
        content[place] = doubled(60)
    torch.save(content, tmp_path / "state.pt")
    with pytest.raises(ValueError, match="named again"):
        check_archive(tmp_path / "state.pt")


def test_what_a_training_writes_passes_by_far(tmp_path: Path) -> None:
    state = new_state("lite", seed=1, device=torch.device("cpu"))
    for parameter in state.network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    state.optimiser.step()
    save_state(state, tmp_path / "state.pt")
    check_archive(tmp_path / "state.pt")
    buffer = io.BytesIO()
    pickle.dump({name: tuple(tensor.shape) for name, tensor in state.network.state_dict().items()}, buffer, protocol=2)
    check_pickle(buffer.getvalue())
