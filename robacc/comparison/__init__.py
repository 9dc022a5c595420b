"""Several results side by side: which differences are real, which result is the better one, which has a grade."""
