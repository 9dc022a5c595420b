"""Hook of pre-commit: read each file as a robot file and report every mistake; exit status 3 if there is one."""

import sys
from collections.abc import Sequence

from robacc.errors import InputError, RobaccError


def main(paths: Sequence[str]) -> int:
    """Read the robot files and return the exit status."""
    from robacc.modelling.robot_file import read_robot
    from robacc.render.text import say_error

    status = 0
    for path in paths:
        try:
            read_robot(path)
        except RobaccError as error:
            say_error(error)
            status = InputError.exit_status
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
