"""Readers, exporters and effects that use robacc's entry points, as a site's own would."""
