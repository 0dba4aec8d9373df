"""The arm: its kinematics and dynamics, how it moves, and what it touches."""
