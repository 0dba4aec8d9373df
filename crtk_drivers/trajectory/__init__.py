"""Motion in time: profiles of a move, interpolation of a stream. Numbers in, numbers out."""
