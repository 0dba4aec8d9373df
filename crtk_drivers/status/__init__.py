"""How a device is: its state, its health, what watches over it."""
