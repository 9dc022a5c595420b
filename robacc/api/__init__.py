"""What the command line does, as calls: one a command, with the same options and the same results.

:mod:`robacc` itself offers all of them; the command line parses, calls these, and renders.
"""
