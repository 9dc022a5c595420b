"""The command line: each command parses its options, makes one call of :mod:`robacc.api`, and renders the result."""
