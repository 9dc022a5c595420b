"""Results of one arm over time, and of many arms: what changed, when, and which arm is unlike the others."""
