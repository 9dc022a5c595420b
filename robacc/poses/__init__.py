"""Measured poses: their columns, their checks, and the CSV and Parquet files they are in."""
