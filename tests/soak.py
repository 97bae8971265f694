"""Load and faults, measured on the command line: ``make soak`` runs it; its figures stand in docs/reliability.md.

    python tests/soak.py [strangers] [kill] [full] [closed] [two] [many] [large]

strangers: each strange file that tests/strangers describes; prints the table of docs/reliability.md.
kill: SIGKILL at random moments of train, depth, run and calibrate; the next call must finish, and files be whole.
full: no file may grow beyond a limit, as on a full disk, at growing limits; the same must hold.
closed: folders that cannot be written to. two: two commands into one run folder at once.
many: a thousand captures, links to a few. large: pairs of 12, 50 and 200 megapixels.

Each call is a process of its own, forked after the imports: these take longer than most of the calls.
TELEWIDE_KILLS (20), TELEWIDE_CAPTURES (100,1000) and TELEWIDE_MEGAPIXELS (12,50,200) say how much.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import pkgutil
import random
import resource
import shlex
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from strangers.table import Given, rows
from strangers.world import write_run, write_world

import telewide
import telewide.stages.train
from telewide.capture.images import read_image
from telewide.capture.pfm import read_pfm
from telewide.cli import main as call_telewide
from telewide.npz import read_npz
from telewide.records import read_json
from telewide.simulate.captures import write_captures
from telewide.simulate.phone import write_phone

SEED, N_KILLS = 7, int(os.environ.get("TELEWIDE_KILLS", "20"))
MANY = [int(count) for count in os.environ.get("TELEWIDE_CAPTURES", "100,1000").split(",")]
SIDES = {12: (4000, 3000), 50: (8192, 6144), 200: (16384, 12288)}
LARGE = [int(megapixels) for megapixels in os.environ.get("TELEWIDE_MEGAPIXELS", "12,50,200").split(",")]
TINY = (
    "--quiet --recipe quick --set network=lite --set train.start=scratch --set train.crop_hw=[64,64] "
    "--set train.rehearsal.steps=0 --set train.photometric.steps=2 --set train.photometric.least_steps=1 "
    "--set train.photometric.captured=1 --set train.stages=1 --set train.feature.steps=2 "
    "--set train.feature.captured=1 --set train.feature.captured_loss=feature --set train.judge_every_steps=2"
)
COMMANDS = {
    "depth": "depth captures --method sgm --bokeh --quiet",
    "train": f"train captures --out run {TINY}",
    "run": f"run captures --out run {TINY}",
    "calibrate": "calibrate boards --square-m 0.025 --out rig.yaml --quiet",
}
MADE = ("run", "rig.yaml", "rig.html")
PASSES = {0, 4}
RIG, STUCK_S = Path(__file__).parents[1] / "calib" / "rigs" / "example_phone.yaml", 600


@dataclass(frozen=True)
class Ended:
    """A command that has ended: its exit code, what it said, and what it took; a busy machine changes ``wall_s``."""

    code: int
    said: str
    wall_s: float
    cpu_s: float
    peak_mb: float


@dataclass(frozen=True)
class Call:
    """A command that runs in a process, and a group, of its own."""

    pid: int
    heard: int
    begun_s: float

    def end(self) -> Ended:
        """Wait for it."""
        with os.fdopen(self.heard, encoding="utf-8", errors="replace") as stream:
            said = stream.read()
        _, status, usage = os.wait4(self.pid, 0)
        return Ended(
            code=os.waitstatus_to_exitcode(status),
            said=said,
            wall_s=time.monotonic() - self.begun_s,
            cpu_s=usage.ru_utime + usage.ru_stime,
            peak_mb=usage.ru_maxrss / 1024,
        )


def started(work: str | Callable[[], object], folder: Path, *, first: Callable[[], object] | None = None) -> Call:
    """Begin a command, or another piece of work, in a folder."""
    heard, told = os.pipe()
    begun_s = time.monotonic()
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            code = _as_child(work, folder, told, first)
        finally:  # nothing of the caller may run on here
            os._exit(code)
    os.close(told)
    return Call(pid, heard, begun_s)


def _as_child(work: str | Callable[[], object], folder: Path, told: int, first: Callable[[], object] | None) -> int:
    os.setsid()
    os.chdir(folder)
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    os.dup2(told, sys.stderr.fileno())
    os.close(told)
    try:
        if first is not None:
            first()
        if isinstance(work, str):
            call_telewide(shlex.split(work))
        work()
    except SystemExit as left:
        return int(left.code or 0)
    except BaseException:
        traceback.print_exc()
        return 1
    finally:
        sys.stderr.flush()
    return 0


def finished(work: str | Callable[[], object], folder: Path, *, first: Callable[[], object] | None = None) -> Ended:
    """Do it, and wait for it; no traceback is allowed."""
    ended = started(work, folder, first=first).end()
    assert "Traceback" not in ended.said, ended.said
    return ended


def done(work: str | Callable[[], object], folder: Path) -> Ended:
    """Do what must succeed."""
    ended = finished(work, folder)
    assert ended.code in PASSES, ended.said
    return ended


def refuse_pieces(folder: Path) -> None:
    """Each file below a folder is whole, or carries a temporary name."""
    readers: dict[str, Callable[[Path], object]] = {".png": read_image, ".jpg": read_image, ".pfm": read_pfm}
    readers |= {".json": read_json, ".npz": lambda path: read_npz(path, ())}
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith(".telewide-") and path.suffix in readers:
            readers[path.suffix](path)


def make_world() -> None:
    """Captures, and boards of a simulated phone, in the current folder."""
    write_captures(Path("captures"), count=2, seed=1, hw=(96, 144), factor=2)
    write_captures(Path("small"), count=2, seed=1, hw=(96, 128), factor=2)
    write_captures(Path("sharp"), count=1, seed=1, hw=(768, 1024), factor=2)
    write_phone(Path("phone"), captures=1, boards=9, seed=1, width=640)
    shutil.move("phone/boards", "boards")


def forget(folder: Path) -> None:
    for made in MADE:
        target = folder / made
        shutil.rmtree(target, ignore_errors=True) if target.is_dir() else target.unlink(missing_ok=True)


def copied(base: Path, name: str) -> Path:
    return Path(shutil.copytree(base, base.with_name(name)))


def strangers(base: Path) -> None:
    made = base.with_name("here")
    made.mkdir()
    done(lambda: write_world(made, rig=RIG), base)
    done(write_run, made)
    for row in rows(copied(made, "strangers"), call=given_by):
        tell(row)


def given_by(command: str, folder: Path) -> Given:
    """Run a command with a limit of processor time, and of what it may ask for; one that waits for ever is killed."""
    own_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    call = started(command, folder, first=limited)
    killer = threading.Timer(STUCK_S, os.killpg, (call.pid, signal.SIGKILL))
    killer.start()
    ended = call.end()
    killer.cancel()
    return Given(
        ended.code,
        ended.said,
        seconds=ended.cpu_s,
        megabytes=max(0.0, ended.peak_mb - own_mb),
        megabytes_in_all=ended.peak_mb,
    )


def limited() -> None:
    """Hear both streams, and end what takes all the machine has."""
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
    resource.setrlimit(resource.RLIMIT_AS, (16 << 30, 16 << 30))


def kill(base: Path) -> None:
    generator = random.Random(SEED)
    # A process that prepares crops begins with all the imports, which take longer than such a training.
    telewide.stages.train.workers_for = lambda device: 0
    for name, command in COMMANDS.items():
        folder = copied(base, f"kill-{name}")
        whole = done(command, folder)
        n_cut = 0
        for _ in range(N_KILLS):
            forget(folder)
            call = started(command, folder)
            time.sleep(generator.uniform(0, whole.wall_s))
            os.killpg(call.pid, signal.SIGKILL)
            n_cut += call.end().code == -signal.SIGKILL
            done(lambda folder=folder: refuse_pieces(folder), folder)
            done(command, folder)
            done(lambda folder=folder: refuse_pieces(folder), folder)
            assert not list(folder.rglob(".telewide-*")), "what was left is removed by the next call"
        tell(f"kill {name}: {N_KILLS} calls killed, {n_cut} before their end, all went on; a whole one: {cost(whole)}")


def full(base: Path) -> None:
    for name, command in COMMANDS.items():
        folder = copied(base, f"full-{name}")
        codes = []
        for limit in (1, 1_000, 20_000, 100_000, 400_000, 2_000_000):
            ended = finished(
                command, folder, first=lambda limit=limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            )
            codes.append(ended.code)
            done(lambda folder=folder: refuse_pieces(folder), folder)
        done(command, folder)
        tell(f"full {name}: exit codes {codes} at growing limits, then done")


def closed(base: Path) -> None:
    """Nothing may be written below the folder: before the first call, and where a call has left something to do."""
    for name, command in COMMANDS.items():
        folder = copied(base, f"closed-{name}")
        codes = []
        for is_made in (False, True):
            if is_made:
                done(command, folder)
                shutil.rmtree(folder / "run" / "depth", ignore_errors=True)
            modes = {path: path.stat().st_mode for path in (folder, *folder.rglob("*"))}
            before = {path: path.stat().st_mtime_ns for path in modes}
            for path, mode in modes.items():
                path.chmod(mode & ~0o222)
            codes.append(finished(command, folder, first=obey_modes).code)
            assert {path: path.stat().st_mtime_ns for path in (folder, *folder.rglob("*"))} == before
            for path, mode in modes.items():
                path.chmod(mode)
        tell(f"closed {name}: exit codes {codes}; nothing was written")


def obey_modes() -> None:
    """Give up root's privilege to write what no mode allows (capabilities(7): CAP_DAC_OVERRIDE)."""
    libc = ctypes.CDLL(None, use_errno=True)
    header, sets = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    if os.getuid() == 0 and libc.capget(header, sets) == 0:
        sets[0] &= ~(1 << 1)
        libc.capset(header, sets)


def two(base: Path) -> None:
    folder = copied(base, "two")
    loud = COMMANDS["run"].replace("--quiet ", "")
    first = started(loud, folder)
    while not (folder / "run").exists():  # made by the first when it begins to work there
        time.sleep(0.1)
    second = finished(loud, folder)
    assert (first.end().code, second.code) == (0, 0), second.said
    waited = [line for line in second.said.splitlines() if "another telewide" in line]
    assert waited, "the second says that it waits"
    tell(f"two: both finished; the second said: {waited[0]}")


def many(base: Path) -> None:
    for count in MANY:
        folder = base.with_name(f"many-{count}")
        for number in range(count):
            capture = folder / "captures" / f"{number:04d}"
            capture.mkdir(parents=True)
            for view in ("tele", "wide"):
                (capture / f"{view}.png").symlink_to(base / "small" / f"00{number % 2}" / f"{view}.png")
        (folder / "captures" / "captures.yaml").write_text("rectified: true\n")
        command = "depth captures --method sgm --quiet"
        tell(f"many: {count} captures, {cost(done(command, folder))}; again {cost(done(command, folder))}")


def large(base: Path) -> None:
    for megapixels in LARGE:
        folder = base.with_name(f"large-{megapixels}")
        (folder / "captures" / "a").mkdir(parents=True)

        def enlarge(folder: Path = folder, wh: tuple[int, int] = SIDES[megapixels]) -> None:
            for view in ("tele", "wide"):
                with Image.open(base / "sharp" / "000" / f"{view}.png") as photo:
                    photo.resize(wh, Image.Resampling.BICUBIC).save(folder / "captures" / "a" / f"{view}.jpg")

        done(enlarge, folder)
        (folder / "captures" / "captures.yaml").write_text("rectified: true\n")
        ended = done("depth captures --method sgm --bokeh --quiet", folder)
        assert ended.code == 0, ended.said
        shape = np.shape(read_pfm(folder / "run" / "depth" / "a" / "disparity.pfm"))
        tell(f"large: {megapixels} megapixels, {cost(ended)}; depth of {shape[1]} x {shape[0]} px")


def cost(ended: Ended) -> str:
    """What a call took."""
    return f"{ended.cpu_s:.1f} s of one core ({ended.wall_s:.1f} s passed), {ended.peak_mb:.0f} MB"


def children_s() -> float:
    """Processor time of all calls that have ended, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parts: dict[str, Callable[[Path], None]] = {
        "strangers": strangers,
        "kill": kill,
        "full": full,
        "closed": closed,
        "two": two,
    }
    parts |= {"many": many, "large": large}
    for module in pkgutil.walk_packages(telewide.__path__, "telewide."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    with tempfile.TemporaryDirectory(prefix="telewide-soak-") as temporary:
        base = Path(temporary) / "world"
        base.mkdir()
        done(make_world, base)
        for name in sys.argv[1:] or parts:
            begun_s, before_s = time.monotonic(), children_s()
            parts[name](base)
            passed_s = time.monotonic() - begun_s
            tell(f"{name}: {children_s() - before_s:.0f} s of one core in all ({passed_s:.0f} s passed)")


if __name__ == "__main__":
    main()
