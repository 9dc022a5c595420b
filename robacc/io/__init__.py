"""Files, lines, tables and YAML nodes; the only package that opens files."""
