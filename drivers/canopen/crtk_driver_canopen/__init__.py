"""CANopen joints: CiA 402 drives on a CAN bus as one arm."""
