"""Everything after the network: `curve_pass` is the path from its readings to finished curves."""
