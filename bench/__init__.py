"""Figures of this project, one command each: ``python -m bench.ur_loop --help``.

They run on one machine against the simulated UR controller, and print what they measured, the peer in the
same run, and the machine. `docs/performance.md` lists them. `bench.screenshots` takes the pictures of the
docs.
"""
