"""Measured poses: their columns, their checks, and their CSV and Parquet files."""
