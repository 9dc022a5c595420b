"""Robot descriptions: DH tables and URDF, read into one record and one chain."""
