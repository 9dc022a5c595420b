"""Models of an arm with effects: predictions and their Jacobian, and residuals of the instrument."""
