"""The closed loop: find the residual, trace it to an effect, add the effect, report before and after."""
