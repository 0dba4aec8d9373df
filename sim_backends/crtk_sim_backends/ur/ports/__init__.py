"""What clients connect to: each port of a controller, bytes in and bytes out."""
