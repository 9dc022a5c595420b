"""Charts of results, made from the JSON document alone, for HTML pages and files."""
