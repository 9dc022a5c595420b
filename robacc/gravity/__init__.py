"""Weights of an arm and its payload, and the torques and forces that gravity exerts on the joints."""
