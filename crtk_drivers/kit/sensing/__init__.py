"""What drivers of sensors that stream have in common: datagrams, numbers that count them, filters, loads."""
