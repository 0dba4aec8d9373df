"""SCHUNK: electric grippers (EGU, EGK, EZU), and force sensors (FTS) at their Ethernet box."""
