"""Search for the effects that explain the residual, add them to the model, and report the error before and after."""
