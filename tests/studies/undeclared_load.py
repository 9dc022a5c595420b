"""Loads that the robot file does not state, on an arm simulated by tests/independent_arm.py: link, mass, false names.

    PYTHONPATH=.. python undeclared_load.py --loads 40        # a load of 5 to 40 kg on a link, masses 10 % wrong
    PYTHONPATH=.. python undeclared_load.py --wrong 40        # no load, masses 20 % wrong, centres of mass by 3 cm

Joints 2 and 3 give way by 0.5 to 3 urad/(N m). The draw of mass and place differs from the prior of the package.
"""

import argparse
import time

import independent_arm
import numpy as np
from independent_arm import DH, Matrix, load_torques, measured, run, targets
from searched import fitted

from robacc.effects.elastic import JointCompliance
from robacc.fitting.masses import UndeclaredLoad, undeclared_load
from robacc.measurements import Measurements

NOISE = 1e-5
N = 80


def poses(seed: int, rng: np.random.Generator, error: float, mass: float, com: Matrix, link: int) -> Measurements:
    """Poses of an arm with a load on a link, whose masses and centres of mass are not the file's."""
    compliance = np.zeros(6)
    compliance[1:3] = 10 ** rng.uniform(-6.3, -5.5, 2)
    rows = [
        (*row, own * max(0.2, 1 + error * rng.normal()), tuple(np.array(centre) + 0.15 * error * rng.normal(size=3)))
        for *row, own, centre in DH
    ]
    independent_arm.DH, stated = tuple(rows), independent_arm.DH  # type: ignore[assignment]
    joints = run(N, seed)
    torque = load_torques(joints.q, mass, com, link)
    independent_arm.DH = stated
    return measured(joints, targets(joints.q + compliance[:, None] * torque), NOISE, seed)


def judged(data: Measurements) -> UndeclaredLoad | None:
    return undeclared_load(fitted(data, (JointCompliance(("j2", "j3"), "uncertain"),)), data)


def loads(sets: int) -> None:
    named = right = inside = 0
    for seed in range(sets):
        rng = np.random.default_rng(100 + seed)
        link, mass, com = int(rng.integers(1, 6)), float(rng.uniform(5, 40)), 0.15 * rng.normal(size=3)
        result = judged(poses(seed, rng, 0.1, mass, com, link))
        text = "nothing" if result is None else result.statement
        print(f"{seed}: {mass:.1f} kg on the link of j{link + 1}: {text}", flush=True)
        if result is not None and result.is_named:
            found = [place for place in result.places if place.link == f"j{link + 1}" and place.mass > 0]
            named, right = named + 1, right + bool(found)
            inside += any(place.low <= mass <= place.high for place in found)
    print(f"named {named} of {sets}, the true link among the links {right}, its mass in the interval {inside}")


def wrong(sets: int) -> None:
    named = 0
    for seed in range(sets):
        result = judged(poses(seed, np.random.default_rng(100 + seed), 0.2, 0.0, np.zeros(3), 0))
        named += result is not None and result.is_named
        if result is not None:
            best = result.places[0]
            print(f"{seed}: best {best.link} at a log Bayes factor of {best.log_bayes_factor:.1f}", flush=True)
    print(f"a load is named in {named} of {sets}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--loads", type=int, default=0, metavar="SETS")
    parser.add_argument("--wrong", type=int, default=0, metavar="SETS")
    options = parser.parse_args()
    loads(options.loads) if options.loads else None
    wrong(options.wrong) if options.wrong else None
    print(f"{time.process_time():.0f} s of processor time")


if __name__ == "__main__":
    main()
