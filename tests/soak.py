"""Load and faults, measured on the command line: ``make soak`` runs it; its figures stand in docs/reliability.md.

    python tests/soak.py [kill] [full] [closed] [two] [many] [large]

kill: SIGKILL at random moments of train, depth, run and calibrate; the next call must finish, and files be whole.
full: no file may grow beyond a limit, as on a full disk, at growing limits; the same must hold.
closed: folders that cannot be written to. two: two commands into one run folder at once.
many: a thousand captures, links to a few. large: pairs of 12, 50 and 200 megapixels.

Each call is a process of its own, forked after the imports: these take longer than most of the calls.
TELEWIDE_KILLS (20), TELEWIDE_CAPTURES (10,100,1000) and TELEWIDE_MEGAPIXELS (12,50,200) say how much.
"""

from __future__ import annotations

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
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

import telewide
from telewide.capture.images import read_image, read_pfm
from telewide.cli import main as call_telewide
from telewide.files import read_json
from telewide.npz import read_npz
from telewide.simulate.captures import write_captures
from telewide.simulate.phone import write_phone

SEED, N_KILLS = 7, int(os.environ.get("TELEWIDE_KILLS", "20"))
MANY = [int(count) for count in os.environ.get("TELEWIDE_CAPTURES", "10,100,1000").split(",")]
SIDES = {12: (4000, 3000), 50: (8192, 6144), 200: (16384, 12288)}
LARGE = [int(megapixels) for megapixels in os.environ.get("TELEWIDE_MEGAPIXELS", "12,50,200").split(",")]
TINY = (
    "--quiet --recipe quick --set train.rehearsal.steps=20 --set train.crop_hw=[64,64] --set train.photometric.steps=0 "
    "--set train.stages=0 --set train.judge_every_steps=5"
)
COMMANDS = {
    "depth": "depth captures --method sgm --bokeh --quiet",
    "train": f"train captures --out run {TINY}",
    "run": f"run captures --out run {TINY}",
    "calibrate": "calibrate boards --square-m 0.025 --out rig.yaml --quiet",
}
MADE = ("run", "rig.yaml", "rig.html")
PASSES = {0, 4}
NO_WRITER = 65534
"""The user that nobody is: root may write anywhere."""


@dataclass(frozen=True)
class Call:
    """A command that runs in a process, and a group, of its own."""

    pid: int
    heard: int
    begun_s: float

    def end(self) -> tuple[int, str, float, float]:
        """Wait for it; exit code, what was said, seconds, and peak memory in MB."""
        with os.fdopen(self.heard, encoding="utf-8", errors="replace") as stream:
            said = stream.read()
        _, status, usage = os.wait4(self.pid, 0)
        return os.waitstatus_to_exitcode(status), said, time.monotonic() - self.begun_s, usage.ru_maxrss / 1024


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


def finished(
    work: str | Callable[[], object], folder: Path, *, first: Callable[[], object] | None = None
) -> tuple[int, str, float, float]:
    """Do it, and wait for it; see `Call.end`."""
    return started(work, folder, first=first).end()


def done(work: str | Callable[[], object], folder: Path) -> float:
    """Do what must succeed; the seconds it took."""
    code, said, seconds, _ = finished(work, folder)
    assert code in PASSES, said
    assert "Traceback" not in said, said
    return seconds


def refuse_pieces(folder: Path) -> None:
    """Each file below a folder is whole, or carries a temporary name."""
    readers: dict[str, Callable[[Path], object]] = {".png": read_image, ".jpg": read_image, ".pfm": read_pfm}
    readers |= {".json": read_json, ".npz": lambda path: read_npz(path, ())}
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith(".telewide-") and path.suffix in readers:
            readers[path.suffix](path)


def make_world() -> None:
    """Captures, and boards of a simulated phone, in the current folder."""
    write_captures(Path("captures"), count=2, seed=1, hw=(192, 256), factor=2)
    write_phone(Path("phone"), captures=1, boards=9, seed=1, width=640)
    shutil.move("phone/boards", "boards")


def forget(folder: Path) -> None:
    for made in MADE:
        target = folder / made
        shutil.rmtree(target, ignore_errors=True) if target.is_dir() else target.unlink(missing_ok=True)


def copied(base: Path, name: str) -> Path:
    return Path(shutil.copytree(base, base.with_name(name)))


def kill(base: Path) -> None:
    generator = random.Random(SEED)
    for name, command in COMMANDS.items():
        folder = copied(base, f"kill-{name}")
        whole_s = done(command, folder)
        n_cut = 0
        for _ in range(N_KILLS):
            forget(folder)
            call = started(command, folder)
            time.sleep(generator.uniform(0, whole_s))
            os.killpg(call.pid, signal.SIGKILL)
            n_cut += call.end()[0] == -signal.SIGKILL
            done(lambda folder=folder: refuse_pieces(folder), folder)
            done(command, folder)
            done(lambda folder=folder: refuse_pieces(folder), folder)
            assert not list(folder.rglob(".telewide-*")), "what was left is removed by the next call"
        tell(f"kill {name}: {N_KILLS} calls killed, {n_cut} before their end ({whole_s:.0f} s), all went on")


def full(base: Path) -> None:
    for name, command in COMMANDS.items():
        folder = copied(base, f"full-{name}")
        codes = []
        for limit in (1, 1_000, 20_000, 100_000, 400_000, 2_000_000):
            code, said, _, _ = finished(
                command, folder, first=lambda limit=limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            )
            assert "Traceback" not in said, said
            codes.append(code)
            done(lambda folder=folder: refuse_pieces(folder), folder)
        done(command, folder)
        tell(f"full {name}: exit codes {codes} at growing limits, then done")


def closed(base: Path) -> None:
    """Nothing may be written below the folder: first of all, then only into what a call has made."""
    for name, command in COMMANDS.items():
        folder = copied(base, f"closed-{name}")
        codes = []
        for is_made in (False, True):
            if is_made:
                done(command, folder)
                (folder / "captures" / "000" / "tele.png").touch()
            before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
            code, said, _, _ = finished(command, folder, first=lambda: os.setuid(NO_WRITER))
            assert "Traceback" not in said, said
            assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
            codes.append(code)
        tell(f"closed {name}: exit codes {codes}; nothing was written")


def two(base: Path) -> None:
    folder = copied(base, "two")
    loud = COMMANDS["run"].replace("--quiet ", "")
    first = started(loud, folder)
    while not (folder / "run").exists():  # made by the first when it begins to work there
        time.sleep(0.1)
    code, said, _, _ = finished(loud, folder)
    assert (first.end()[0], code) == (0, 0), said
    waited = [line for line in said.splitlines() if "another telewide" in line]
    assert waited, "the second says that it waits"
    tell(f"two: both finished; the second said: {waited[0]}")


def many(base: Path) -> None:
    for count in MANY:
        folder = base.with_name(f"many-{count}")
        for number in range(count):
            capture = folder / "captures" / f"{number:04d}"
            capture.mkdir(parents=True)
            for view in ("tele", "wide"):
                (capture / f"{view}.png").symlink_to(base / "captures" / f"00{number % 2}" / f"{view}.png")
        (folder / "captures" / "captures.yaml").write_text("rectified: true\n")
        code, said, seconds, peak_mb = finished("depth captures --method sgm --quiet", folder)
        assert code == 0, said
        again = finished("depth captures --method sgm --quiet", folder)
        tell(f"many: {count} captures, {seconds:.1f} s, {peak_mb:.0f} MB; again {again[2]:.1f} s, {again[3]:.0f} MB")


def large(base: Path) -> None:
    for megapixels in LARGE:
        folder = base.with_name(f"large-{megapixels}")
        (folder / "captures" / "a").mkdir(parents=True)

        def enlarge(folder: Path = folder, wh: tuple[int, int] = SIDES[megapixels]) -> None:
            for view in ("tele", "wide"):
                with Image.open(base / "captures" / "000" / f"{view}.png") as photo:
                    photo.resize(wh, Image.Resampling.BICUBIC).save(folder / "captures" / "a" / f"{view}.jpg")

        done(enlarge, folder)
        (folder / "captures" / "captures.yaml").write_text("rectified: true\n")
        code, said, seconds, peak_mb = finished("depth captures --method sgm --bokeh --quiet", folder)
        assert code == 0, said
        shape = np.shape(read_pfm(folder / "run" / "depth" / "a" / "disparity.pfm"))
        tell(f"large: {megapixels} megapixels, {seconds:.0f} s, {peak_mb:.0f} MB; depth of {shape[1]} x {shape[0]} px")


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parts: dict[str, Callable[[Path], None]] = {"kill": kill, "full": full, "closed": closed, "two": two}
    parts |= {"many": many, "large": large}
    for module in pkgutil.walk_packages(telewide.__path__, "telewide."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    with tempfile.TemporaryDirectory(prefix="telewide-soak-") as temporary:
        base = Path(temporary) / "world"
        base.mkdir()
        Path(temporary).chmod(0o755)
        done(make_world, base)
        for name in sys.argv[1:] or parts:
            parts[name](base)


if __name__ == "__main__":
    main()
