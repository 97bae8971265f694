"""Run by torchrun: the gradients of a joint step, and a short training, as each process sees them.

python joint_step.py OUT PAIRS
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from training.small import CPU, WINDOW, Heard, ScriptedJudge, source_of, stage_of, training_in

from telewide.capture.pair import Capture
from telewide.matching.inference import full_precision
from telewide.matching.networks import build_network, standardise
from telewide.training.checkpoint import frozen_extractor, new_state
from telewide.training.data import StepBatches
from telewide.training.loop import train
from telewide.training.objective import objective
from telewide.training.options import TrainOptions
from telewide.training.processes import Processes, joined_processes
from telewide.training.samples import SampleSource

STAGES = {
    "as the default recipe": stage_of(steps=1, rehearsed=2, captured=1, captured_loss="labels"),
    "one kind each": stage_of(steps=1, rehearsed=1, captured=1, captured_loss="feature", labels_weight=0.2),
    "uneven": stage_of(steps=1, captured=3, captured_loss="photometric", swaps_views=True),
}


def joint_gradients(source: SampleSource, processes: Processes) -> dict[str, torch.Tensor]:
    """All gradients of one step of each stage, flattened, summed over the processes."""
    gradients = {}
    for name, stage in STAGES.items():
        network = build_network("lite", seed=1)
        with torch.no_grad():  # branches that start at zero pass no gradient on
            for parameter in network.parameters():
                parameter += 0.01
        batch = StepBatches(source, stage, seed=4, rank=processes.rank, world=processes.world)[0]
        with full_precision():
            output = network(standardise(batch.ref_BCHW), standardise(batch.src_BCHW), WINDOW)
            teacher = frozen_extractor(build_network("lite", seed=2))
            loss, _ = objective(output, batch, stage, window=WINDOW, teacher=teacher, global_sum=processes.global_sum)
        torch.autograd.backward(loss)
        processes.sum_gradients(network)
        gradients[name] = torch.cat([p.grad.flatten() for p in network.parameters() if p.grad is not None])
    return gradients


def short_training(folder: Path, source: SampleSource, processes: Processes) -> dict[str, object]:
    """Two stages of two steps; what this process heard."""
    stage = {"steps": 2, "captured": 2, "captured_loss": "photometric"}
    options = TrainOptions.model_validate(
        {"crop_hw": (64, 96), "photometric": stage, "feature": {**stage, "captured_loss": "feature"}, "stages": 1}
    )
    heard = Heard()
    # Only the writer's judge is asked; the others would answer otherwise.
    judge = ScriptedJudge((0.5, 0.4) if processes.is_writer else (0.1, 0.9))
    training = training_in(folder, source, options=options, judge=judge, processes=processes)
    state = train(training, new_state("lite", seed=1, device=CPU), reporter=heard)
    total = sum(float(p.detach().double().sum()) for p in state.network.parameters())
    losses = [[name, step, parts] for (name, step), parts in heard.losses.items()]
    return {"losses": losses, "judgements": heard.judgements, "sum": total, "best_stage": state.best_stage}


def main(out: Path, pairs: Path) -> None:
    """Write this process' findings."""
    torch.set_num_threads(1)
    folders = sorted(path for path in pairs.iterdir() if path.is_dir())
    captures = tuple(Capture(path.name, path / "tele.png", path / "wide.png") for path in folders)
    source = source_of(captures, labels=pairs)
    with joined_processes("cpu") as processes:
        torch.save(joint_gradients(source, processes), out / f"gradients{processes.rank}.pt")
        heard = short_training(out / f"train{processes.rank}", source, processes)
        (out / f"heard{processes.rank}.json").write_text(json.dumps(heard))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
