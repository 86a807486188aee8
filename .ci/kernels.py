"""Make the distribution `sppm-kernels`: machine code of all kernels, with which a first run compiles nothing.

Runs every configuration and example at a low resolution, each in a process of its own, and packs the kernels that were
compiled on the way, and those of the list by which kernels are compiled ahead, for the version of Python that runs
this. The same sources and versions give the same bytes, in any
folder. Kernels that ``NUMBA_CACHE_DIR`` holds, if it is set, are taken from there.

Usage: python .ci/kernels.py [FOLDER] [NAME...], after .ci/install, on Linux on x86-64
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import os
import subprocess
import sys
import sysconfig
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import digests  # noqa: E402
from sppm_pipeline.services.jit import machine_code  # noqa: E402

ENVIRONMENT = {"PYTHONHASHSEED": "0", "SPPM_COMPILE_AHEAD": "off"}
"""Names of symbols count what a process compiled before, so that everything is done in one order, on one thread."""


LISTED = "the kernels of the list"


def run(name: str) -> None:
    """Run a configuration in this process; an exception of a kernel says where it was raised, but in no folder."""
    from numba.core.bytecode import FunctionIdentity
    from numba.np.ufunc import array_exprs

    from sppm_pipeline.engine.cli.main import main as sppm
    from sppm_pipeline.engine.plan.kernels import listed_kernels
    from sppm_pipeline.services.jit.compiling import compile_kernel

    identify = FunctionIdentity.from_function.__func__
    folders = str(ROOT), sysconfig.get_path("purelib"), sysconfig.get_path("stdlib")

    def identified(cls: Any, function: Any) -> Any:
        made = identify(cls, function)
        for folder in folders:
            made.filename = made.filename.removeprefix(f"{folder}/")
        return made

    FunctionIdentity.from_function = classmethod(identified)
    numbers = itertools.count()
    array_exprs.hash = lambda expression: next(numbers)  # names would hold addresses
    if name == LISTED:
        for kernel in listed_kernels():
            compile_kernel(kernel.place, kernel.signatures)
        return
    with tempfile.TemporaryDirectory() as scratch:
        if code := sppm([*digests.command(name, Path(scratch)), "--threads", "1"]):
            raise SystemExit(code)


def compiled(names: Iterable[str], kernels: str) -> dict[str, bytes]:
    """Machine code of all kernels of this repository that these configurations call, by name of its file."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_", "SPPM_"))}
    for name in names:
        print(name, flush=True)
        subprocess.run(
            [sys.executable, __file__, "--run", name],
            env=own | ENVIRONMENT | {"NUMBA_CACHE_DIR": kernels},
            stdout=subprocess.DEVNULL,
            check=True,
        )
    packages, found = {"sppm_pipeline", *(path.name for path in ROOT.glob("plugins/*/sppm_*"))}, {}
    for file in Path(kernels).rglob("*.code"):
        about, _ = machine_code.read(str(file)) or ({"of": ["damaged"]}, b"")
        if about["of"][0].partition(".")[0] in packages:
            found[file.name] = file.read_bytes()
    return found


def packed(folder: Path, code: Mapping[str, bytes], version: str) -> Path:
    """Write the wheel; entries are sorted, and without a date."""
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    short, stem = f"cp{python.replace('.', '')}", f"sppm_kernels-{version}"
    tag = f"{short}-{short}-manylinux_2_17_x86_64"
    metadata = (
        f"Metadata-Version: 2.4\nName: sppm-kernels\nVersion: {version}\n"
        "Summary: Machine code of the kernels of sppm-pipeline, with which a first run compiles nothing\n"
        f"License-Expression: BSD-3-Clause\nLicense-File: LICENSE\nRequires-Python: =={python}.*\n"
    )
    about = f"Wheel-Version: 1.0\nGenerator: sppm\nRoot-Is-Purelib: false\nTag: {tag}\n"
    files = {f"{machine_code.SHIPPED}/{name}": data for name, data in code.items()} | {
        f"{machine_code.SHIPPED}/__init__.py": b'"""Read by `sppm_pipeline.services.jit.machine_code`."""\n',
        f"{stem}.dist-info/METADATA": metadata.encode(),
        f"{stem}.dist-info/WHEEL": about.encode(),
        f"{stem}.dist-info/licenses/LICENSE": (ROOT / "LICENSE").read_bytes(),
    }
    record = "".join(
        f"{name},sha256={base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b'=').decode()},{len(data)}\n"
        for name, data in sorted(files.items())
    )
    files[f"{stem}.dist-info/RECORD"] = f"{record}{stem}.dist-info/RECORD,,\n".encode()
    folder.mkdir(parents=True, exist_ok=True)
    wheel = folder / f"{stem}-{tag}.whl"
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, data in sorted(files.items(), key=lambda one: (".dist-info/" in one[0], one[0])):
            entry = zipfile.ZipInfo(name)
            entry.external_attr, entry.compress_type = 0o100644 << 16, zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
    return wheel


def main() -> None:
    if machine_code.target() != machine_code.LEVEL or not machine_code.usable():
        raise SystemExit(f"not here: {machine_code.reason_unavailable() or 'no ' + machine_code.LEVEL}")
    if sys.argv[1:2] == ["--run"]:
        run(sys.argv[2])
        return
    from importlib.metadata import version

    folder, *names = sys.argv[1:] or ["dist"]
    with tempfile.TemporaryDirectory() as scratch:
        code = compiled(names or [*sorted(digests.SMALL), LISTED], os.environ.get("NUMBA_CACHE_DIR", scratch))
    wheel = packed(Path(folder), code, version("sppm-pipeline"))
    print(f"{wheel}: {len(code)} kernels, {wheel.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
