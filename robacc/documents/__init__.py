"""JSON documents of results: one module for each command, their common envelope, and reading them back."""
