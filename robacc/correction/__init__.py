"""Commands that make a real arm reach its wanted poses, from a model of the arm."""
