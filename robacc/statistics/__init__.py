"""Statistics of error vectors: distributions, quadratic forms, intervals, multivariate tests, dependence of poses."""
