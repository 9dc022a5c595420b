"""What all tests share: linear algebra on one thread, as the command line runs it (see ``robacc.cli.main.main``)."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
