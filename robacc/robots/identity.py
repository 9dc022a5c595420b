"""Identity of what was tested: the arm's serial number, the instrument, who measured where and when."""

from __future__ import annotations

from robacc.io.yaml_nodes import YamlSection

IDENTITY = {
    "customer": "Customer",
    "order": "Order",
    "robot": "Robot",
    "serial_number": "Serial number",
    "controller": "Controller",
    "instrument": "Instrument",
    "instrument_serial": "Serial number of the instrument",
    "certificate": "Calibration certificate",
    "operator": "Operator",
    "place": "Place",
    "date": "Date of the measurement",
    "remarks": "Remarks",
}
"""Keys of an identity and their labels on a page, in the order of the page."""


def read_identity(section: YamlSection) -> dict[str, str]:
    """Return the identity of a section with the keys of :data:`IDENTITY`; its source collects problems."""
    identity = {}
    for key in IDENTITY:
        node = section.get(key)
        text = None if node is None else section.source.text(node, section.at(key))
        if text is not None:
            identity[key] = text
    return identity
