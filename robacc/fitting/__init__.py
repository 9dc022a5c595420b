"""Least squares over poses, and all that belongs to it: registration, identifiability, priors, outliers, folds."""
