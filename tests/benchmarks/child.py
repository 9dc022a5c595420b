"""Runs a command and prints what it alone cost: processor time (s) and largest memory (MB), as a JSON list.

To be run as ``python -S child.py COMMAND …``. Linux counts what a process occupied before its ``exec`` as its own, so a
command started by a large process (pytest with a million poses in memory) would seem as large as that: a small one
starts it. Its standard output goes nowhere; its exit status is passed on.
"""

import json
import os
import sys

OUTPUT = os.open(os.devnull, os.O_WRONLY)
CHILD = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, OUTPUT, 1)])
_, STATUS, USAGE = os.wait4(CHILD, 0)
print(json.dumps([USAGE.ru_utime + USAGE.ru_stime, USAGE.ru_maxrss / 1024]))
sys.exit(os.waitstatus_to_exitcode(STATUS))
