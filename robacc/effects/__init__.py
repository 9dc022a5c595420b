"""What can be wrong with an arm beyond its nominal table, one effect a file."""
