"""Gates: named criteria for the figures of a result, decided with the uncertainty of the figures."""
