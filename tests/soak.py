"""Load and faults, measured on the command line: ``make soak`` runs it; its figures stand in docs/reliability.md.

    python tests/soak.py [kill] [full] [two] [many] [large]

kill: SIGKILL at random moments of train, depth, run and calibrate; the next call must finish, and files be whole.
full: no file may grow beyond a limit, as on a full disk, at growing limits; the same must hold.
two: two commands into one run folder at once.
many: a thousand captures, links to a few. large: pairs of 12, 50 and 200 megapixels.
"""

from __future__ import annotations

import os
import random
import resource
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from telewide.capture.images import read_image, read_pfm
from telewide.files import read_json
from telewide.npz import read_npz
from telewide.simulate.captures import write_captures
from telewide.simulate.phone import write_phone

SEED, N_KILLS = 7, int(os.environ.get("TELEWIDE_KILLS", "20"))
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
PASSES = {0, 4}


def started(command: str, folder: Path, **options: object) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "telewide", *shlex.split(command)]
    return subprocess.Popen(words, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, **options)  # type: ignore[call-overload,no-any-return]


def finished(command: str, folder: Path, **options: object) -> tuple[int, str, float, float]:
    """Exit code, what was said, seconds, and peak memory in MB."""
    begun_s = time.monotonic()
    process = started(command, folder, **options)
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, usage = os.wait4(process.pid, 0)
    return os.waitstatus_to_exitcode(status), said, time.monotonic() - begun_s, usage.ru_maxrss / 1024


def refuse_pieces(folder: Path) -> None:
    """Each file below a folder is whole, or carries a temporary name."""
    readers: dict[str, Callable[[Path], object]] = {".png": read_image, ".jpg": read_image, ".pfm": read_pfm}
    readers |= {".json": read_json, ".npz": lambda path: read_npz(path, ())}
    for path in folder.rglob("*"):
        if path.is_file() and not path.name.startswith(".telewide-") and path.suffix in readers:
            readers[path.suffix](path)


def world(folder: Path) -> Path:
    """Captures, and boards of a simulated phone."""
    write_captures(folder / "captures", count=2, seed=1, hw=(192, 256), factor=2)
    write_phone(folder / "phone", captures=1, boards=9, seed=1, width=640)
    shutil.move(folder / "phone" / "boards", folder / "boards")
    return folder


def kill(base: Path) -> None:
    generator = random.Random(SEED)
    for name, command in COMMANDS.items():
        folder = Path(shutil.copytree(base, base.with_name(f"kill-{name}")))
        code, said, whole_s, _ = finished(command, folder)
        assert code in PASSES, said
        n_cut = 0
        for _ in range(N_KILLS):
            for made in ("run", "rig.yaml", "rig.html"):
                target = folder / made
                shutil.rmtree(target, ignore_errors=True) if target.is_dir() else target.unlink(missing_ok=True)
            process = started(command, folder, start_new_session=True)
            time.sleep(generator.uniform(0.3, whole_s))
            n_cut += process.poll() is None
            os.killpg(process.pid, signal.SIGKILL) if process.poll() is None else None
            process.communicate()
            refuse_pieces(folder)
            code, said, _, _ = finished(command, folder)
            assert code in PASSES, said
            assert "Traceback" not in said, said
            refuse_pieces(folder)
            assert not list(folder.rglob(".telewide-*")), "what was left is removed by the next call"
        tell(f"kill {name}: {N_KILLS} calls killed, {n_cut} before their end ({whole_s:.0f} s), all went on")


def full(base: Path) -> None:
    for name, command in COMMANDS.items():
        folder = Path(shutil.copytree(base, base.with_name(f"full-{name}")))
        codes = []
        for limit in (1, 1_000, 20_000, 100_000, 400_000, 2_000_000):
            code, said, _, _ = finished(
                command,
                folder,
                preexec_fn=lambda limit=limit: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
            )
            assert "Traceback" not in said, said
            codes.append(code)
            refuse_pieces(folder)
        code, said, _, _ = finished(command, folder)
        assert code in PASSES, said
        tell(f"full {name}: exit codes {codes}, then {code}")


def two(base: Path) -> None:
    folder = Path(shutil.copytree(base, base.with_name("two")))
    loud = COMMANDS["run"].replace("--quiet ", "")
    first = started(loud, folder)
    while not (folder / "run").exists():  # made by the first when it begins to work there
        time.sleep(0.1)
    code, said, _, _ = finished(loud, folder)
    first.communicate()
    assert (first.returncode, code) == (0, 0), said
    waited = [line for line in said.splitlines() if "another telewide" in line]
    assert waited, "the second says that it waits"
    tell(f"two: both finished; the second said: {waited[0]}")


def many(base: Path) -> None:
    for count in (10, 100, 1000):
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
    for megapixels, wh in ((12, (4000, 3000)), (50, (8192, 6144)), (200, (16384, 12288))):
        folder = base.with_name(f"large-{megapixels}")
        for view in ("tele", "wide"):
            with Image.open(base / "captures" / "000" / f"{view}.png") as photo:
                (folder / "captures" / "a").mkdir(parents=True, exist_ok=True)
                photo.resize(wh, Image.Resampling.BICUBIC).save(folder / "captures" / "a" / f"{view}.jpg", quality=90)
        (folder / "captures" / "captures.yaml").write_text("rectified: true\n")
        code, said, seconds, peak_mb = finished("depth captures --method sgm --bokeh --quiet", folder)
        assert code == 0, said
        shape = np.shape(read_pfm(folder / "run" / "depth" / "a" / "disparity.pfm"))
        tell(f"large: {megapixels} megapixels, {seconds:.0f} s, {peak_mb:.0f} MB; depth of {shape[1]} x {shape[0]} px")


def tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main() -> None:
    parts: dict[str, Callable[[Path], None]] = {"kill": kill, "full": full, "two": two, "many": many, "large": large}
    with tempfile.TemporaryDirectory(prefix="telewide-soak-") as temporary:
        base = world(Path(temporary) / "world")
        for name in sys.argv[1:] or parts:
            parts[name](base)


if __name__ == "__main__":
    main()
