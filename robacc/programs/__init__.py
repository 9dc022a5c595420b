"""Robot programs: the targets in them, and the same programs with other numbers, everything else byte for byte."""
