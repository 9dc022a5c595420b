"""Results as JSON documents: one module a command, the envelope they share, and reading them back."""
