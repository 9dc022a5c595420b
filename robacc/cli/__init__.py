"""One file a command: parse, load, call one function, render."""
