"""Second views that are sharpened first.

A restorer has weights of a file, or is trained on the sharp views of the scenes to learn from, for the damage that it
assumes.
"""

from __future__ import annotations

import statistics
import time
from functools import partial
from itertools import pairwise
from pathlib import Path

from pydantic import JsonValue
from safetensors.torch import save
from torch import nn

from telewide.benchmark.datasets.truth import StereoTruth
from telewide.benchmark.paper.pairs import digest_of
from telewide.benchmark.paper.sources import source_fingerprint
from telewide.benchmark.paper.system import Place, SecondView, Task, content_fingerprint
from telewide.capture.images import resize_bicubic
from telewide.errors import InputError, TelewideError, UsageError
from telewide.files import fingerprint, is_file, replacing
from telewide.folders import alone_in
from telewide.geometry.arrays import FloatImage
from telewide.matching.inference import choose_device
from telewide.restoration.crops import CropSource
from telewide.restoration.restorers import RESTORERS, build_restorer, restore
from telewide.restoration.training import train_restorer

_SMALL_PX, _CROPS = 32, 4
"""Of a batch: on processors less than published (48 and 16), so that some hundred steps fit a budget of minutes."""
_TIMED_STEPS = 3


def restored_view(name: str, task: Task, place: Place) -> tuple[SecondView, dict[str, JsonValue]]:
    """Second views sharpened by a restorer.

    Args:
        name: of the restorer.
        task: damage, factor, and where weights come from.
        place: of everything that is learned.

    Returns:
        What makes them, and all that they depend on besides the pictures.

    Raises:
        UsageError: the restorer cannot enlarge by the task's factor.
        InputError: weights do not fit, or no picture is large enough to learn from.
    """
    factor = round(task.factor)
    if factor != task.factor:
        raise UsageError(f"{name} enlarges by whole factors, not by {task.factor:g}", hint="take another factor")
    files = task.weights.get(name, ())
    network, facts = _read(name, factor, files) if files else _trained(name, factor, task, place)
    network = network.to(choose_device(task.device))

    def restored(scene: str, truth: StereoTruth) -> FloatImage:
        sharpened = restore(task.small_view(scene, truth), network)
        # Pictures whose sides the factor does not divide were shrunken to whole pixels.
        return resize_bicubic(sharpened, wh=(truth.left.shape[1], truth.left.shape[0]))

    return restored, {"restorer": facts}


def _read(name: str, factor: int, files: tuple[Path, ...]) -> tuple[nn.Module, dict[str, JsonValue]]:
    """The first of the files that fits the factor."""
    problem: TelewideError | None = None
    for path in files:
        try:
            network = build_restorer(name, factor=factor, weights=path)
        except InputError as error:
            problem = problem or error
            continue
        return network, {"name": name, "weights": fingerprint(path)}
    raise problem or InputError(f"no weights of {name} are named")


def _trained(name: str, factor: int, task: Task, place: Place) -> tuple[nn.Module, dict[str, JsonValue]]:
    network = build_restorer(name, factor=factor, seed=task.seed)
    pictures = [scene.read().left for scene in task.training]
    facts: dict[str, JsonValue] = {
        "name": name,
        "factor": factor,
        "pictures": [content_fingerprint(scene.read()) for scene in task.training],
        "budget": task.budget.as_data(),
        "seed": task.seed,
        "sources": source_fingerprint(["benchmark.paper.restored", f"restoration.restorers:{name}"]),
    }
    folder = place.folder / "restorers" / digest_of(facts)
    with alone_in(folder, waiting=place.tell):
        path = folder / f"{name}-x{factor}.safetensors"
        if not is_file(path):
            device = choose_device(task.device)
            least = min((min(picture.shape[:2]) for picture in pictures), default=0)
            source = CropSource(
                pictures,
                factor=factor,
                kernels=RESTORERS[name].kernels,
                small_px=min(_SMALL_PX, least // factor),
                count=_CROPS,
            )
            _train(network.to(device), source, name=name, task=task, tell=partial(_say, place, f"{name} x{factor}"))
            with replacing(path) as temporary:
                temporary.write_bytes(save({k: v.detach().cpu().contiguous() for k, v in network.state_dict().items()}))
        return build_restorer(name, factor=factor, weights=path), facts


def _train(network: nn.Module, source: CropSource, *, name: str, task: Task, tell: partial[None]) -> None:
    steps = task.budget.steps or _steps_within(60 * task.budget.minutes, network, source, name=name)
    every = max(1, steps // 4)

    def heard(step: int, loss: float) -> None:
        if step % every == 0:
            tell(f"step {step} of {steps}, loss {loss:.4f}")

    train_restorer(network, source, name=name, steps=steps, seed=task.seed, step_done=heard)


def _steps_within(seconds: float, network: nn.Module, source: CropSource, *, name: str) -> int:
    """Time some steps; the weights are as before afterwards."""
    kept = {key: value.clone() for key, value in network.state_dict().items()}
    moments: list[float] = [time.monotonic()]
    train_restorer(
        network,
        source,
        name=name,
        steps=1 + _TIMED_STEPS,
        step_done=lambda _step, _loss: moments.append(time.monotonic()),
    )
    network.load_state_dict(kept)
    lasted = [end - begun for begun, end in pairwise(moments[1:])]
    return max(1, round(seconds / statistics.median(lasted)))


def _say(place: Place, what: str, message: str) -> None:
    place.tell(f"{what}: {message}")
