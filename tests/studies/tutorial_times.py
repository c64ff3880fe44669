"""Run the tutorial's commands, each in a process of its own, and print what each takes.

Example: ``python -m tests.studies.tutorial_times``. Processor time hardly depends on what else the machine does;
the time on the clock does, and stands beside it.
"""

import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tests.pages import ROOT, page_text


def main() -> int:
    """Run from the command line."""
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "sample_logs").symlink_to(ROOT / "sample_logs")
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        print("| command | processor time [s] | on the clock [s] |\n|---|---|---|")
        for block in re.findall(r"```bash\n(.*?)```", page_text("tutorial.md"), flags=re.S):
            for line in block.splitlines():
                # Other commands are the shell's.
                shell = re.sub("^split ", f"{shlex.quote(sys.executable)} -m split_cli ", line)
                before, begin = _spent(), time.perf_counter()
                done = subprocess.run(
                    shell, shell=True, cwd=name, env=environment, capture_output=True, text=True, check=False
                )
                if done.returncode:
                    print(done.stderr, file=sys.stderr)
                    return 1
                print(f"| `{line}` | {_spent() - before:.1f} | {time.perf_counter() - begin:.1f} |", flush=True)
    return 0


def _spent() -> float:
    """Return processor time of all processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    sys.exit(main())
