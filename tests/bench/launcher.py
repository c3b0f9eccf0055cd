"""Runs a command and reports its times and peak memory; a script of its own so as to stay small.

A process begins with the peak memory of the one that it was forked from, so a benchmark that holds
large arrays must not start what it measures itself.
"""

import json
import os
import resource
import subprocess
import sys
from time import perf_counter


def main() -> None:
    """Run the command that the arguments are; print seconds and KiB as JSON behind its output."""
    start = perf_counter()
    done = subprocess.run(
        sys.argv[1:], check=False, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL
    )
    seconds = perf_counter() - start
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    usage = {
        "code": done.returncode,
        "seconds": seconds,
        "processor_seconds": used.ru_utime + used.ru_stime,
        "peak_bytes": used.ru_maxrss * (1 if sys.platform == "darwin" else 1024),
    }
    os.write(1, json.dumps(usage).encode() + b"\n" + done.stdout)


if __name__ == "__main__":
    main()
