"""Control by a program of our own, which reads its commands from RTDE registers in each of its cycles."""
