"""``python -m robacc``."""

from robacc.cli.main import main

main()
