"""Run by torchrun: the gradients of a joint step, and short trainings, as each process sees them.

python joint_step.py OUT PAIRS
"""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from training.small import CPU, WINDOW, Heard, ScriptedJudge, source_of, stage_of, training_in

from telewide.capture.pair import Capture
from telewide.matching.inference import full_precision
from telewide.matching.networks import NETWORKS, StereoNetwork, build_network, standardise
from telewide.training.checkpoint import STATE_NAME, TrainingState, frozen_extractor, load_state, new_state
from telewide.training.data import StepBatches
from telewide.training.loop import train
from telewide.training.objective import objective
from telewide.training.options import TrainOptions
from telewide.training.processes import Processes, joined_processes
from telewide.training.samples import SampleSource

STAGES = {
    "as the default recipe": stage_of(steps=1, rehearsed=1, retaken=2),
    "one kind each": stage_of(steps=1, rehearsed=1, retaken=1, captured=1, captured_loss="feature"),
    "uneven": stage_of(steps=1, captured=3, captured_loss="photometric", swaps_views=True),
}
PRECISE = "psmnet-s in float64"
"""Fresh from its seed psmnet-s multiplies the rounding of float32 a thousandfold; two summation orders would differ."""


class _InFloat64(torch.nn.Module):
    def __init__(self, features: torch.nn.Module) -> None:
        super().__init__()
        self.inner = features

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return self.inner(image.double())


def precise_psmnet() -> StereoNetwork:
    """Build what `PRECISE` names; whoever trains it enters it into ``NETWORKS``."""
    network = NETWORKS["psmnet-s"]()
    return StereoNetwork(_InFloat64(network.features), network.matching).double()


def joint_gradients(source: SampleSource, processes: Processes, *, name: str = "lite") -> dict[str, torch.Tensor]:
    """All gradients of one step of each stage, flattened, summed over the processes."""
    gradients = {}
    for key, stage in STAGES.items():
        network = build_network(name, seed=1)
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
        gradients[key] = torch.cat([p.grad.flatten() for p in network.parameters() if p.grad is not None])
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


def stopped_training(folder: Path, source: SampleSource, processes: Processes, *, stop_rank: int) -> TrainingState:
    """Train psmnet-s in two stages; one process asks to stop within the second, and all go on from the checkpoint."""
    stage = {"steps": 3, "captured": 3, "captured_loss": "photometric"}
    options = TrainOptions.model_validate(
        {"crop_hw": (64, 96), "photometric": stage, "feature": {**stage, "captured_loss": "feature"}, "stages": 1}
    )
    training = training_in(
        folder, source, options=options, judge=ScriptedJudge((0.5, 0.4)), processes=processes, network=PRECISE
    )
    state, heard = new_state(PRECISE, seed=1, device=CPU), Heard()
    if processes.rank == stop_rank:
        heard.after_step = lambda name, step: signal.raise_signal(signal.SIGINT) if step == 2 else None
    for _ in range(2):
        try:
            train(training, state, reporter=heard)
        except KeyboardInterrupt:
            processes.wait()
            state = load_state(folder / STATE_NAME, network_name=PRECISE, device=CPU)
    heard.after_step = None
    return train(training, state, reporter=heard)


def main(out: Path, pairs: Path) -> None:
    """Write this process' findings."""
    torch.set_num_threads(1)
    folders = sorted(path for path in pairs.iterdir() if path.is_dir())
    captures = tuple(Capture(path.name, path / "tele.png", path / "wide.png") for path in folders)
    source = source_of(captures, disparities=pairs)
    with joined_processes("cpu") as processes:
        for name in ("lite", PRECISE):
            torch.save(joint_gradients(source, processes, name=name), out / f"{name}{processes.rank}.pt")
        heard = short_training(out / f"train{processes.rank}", source, processes)
        (out / f"heard{processes.rank}.json").write_text(json.dumps(heard))
        state = stopped_training(out / "stopped", source, processes, stop_rank=1)
        content = {"network": state.network.state_dict(), "average": state.average.state_dict()}
        torch.save(content, out / f"stopped{processes.rank}.pt")


if __name__ == "__main__":
    NETWORKS[PRECISE] = precise_psmnet
    main(Path(sys.argv[1]), Path(sys.argv[2]))
