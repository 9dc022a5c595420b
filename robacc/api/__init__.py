"""One typed call for each command, with the same options and the same results.

:mod:`robacc` exports all of them. The command line parses its arguments, makes these calls, and renders their results.
"""
