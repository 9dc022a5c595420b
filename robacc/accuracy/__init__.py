"""How far the arm was from where it was to be: errors of poses, their figures and statistics, the grade."""
