"""Weights and how they load the joints of an arm."""
