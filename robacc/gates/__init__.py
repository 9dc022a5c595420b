"""Gates: named criteria that a result's figures must meet, decided with the uncertainty that the figures have."""
