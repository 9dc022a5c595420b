"""Simulated poses of an arm with known effects, and template files."""
