"""Parameters of robot controllers: a model written in their formats, and read back."""
