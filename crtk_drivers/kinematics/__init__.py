"""Serial arms: their chain, from DH rows or URDF, and what follows from it."""
