"""One model of the error: declared and identified effects, and the terms of the covariance beside them."""
