"""What is carried out: streams, moves, free drive; who may command, and how it stops."""
