"""What an arm with effects does at given poses: predictions and their Jacobian, and what an instrument sees of it."""
