"""Plan of a measurement: feasible candidates, the poses worth measuring, their order, and what to expect from them."""
