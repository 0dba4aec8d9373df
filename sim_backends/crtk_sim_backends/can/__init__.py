"""A virtual CAN bus that needs no kernel support."""
