"""Comparison of several results: significant differences, a ranking, and the results that meet a grade."""
