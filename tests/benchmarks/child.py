"""Runs a command and prints what it alone cost, as a JSON list: processor time, time on the clock (s), memory (MB).

To be run as ``python -S child.py COMMAND …``. Linux counts what a process occupied before its ``exec`` as its own, so a
command started by a large process (pytest with a million poses in memory) would seem as large as that: a small one
starts it. Its standard output goes nowhere; its exit status is passed on.
"""

import json
import os
import sys
import time

OUTPUT = os.open(os.devnull, os.O_WRONLY)
BEGUN = time.perf_counter()
CHILD = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, OUTPUT, 1)])
_, STATUS, USAGE = os.wait4(CHILD, 0)
CLOCK = time.perf_counter() - BEGUN
print(json.dumps([USAGE.ru_utime + USAGE.ru_stime, CLOCK, USAGE.ru_maxrss / 1024]))
sys.exit(os.waitstatus_to_exitcode(STATUS))
