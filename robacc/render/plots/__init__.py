"""Pictures of results: from the JSON document alone, each drawn by one piece of code for page and paper."""
