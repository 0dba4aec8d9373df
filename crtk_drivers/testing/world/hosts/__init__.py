"""The processes of this machine that worlds run in.

forking         a process that forks a child for each world
host_process    such a process, as who started it sees it
runner          runs scenarios with seeds: `run`, `search`, `shrink`
world_host      the program that runs the scenarios of a file
pytest_worlds   pytest's plugin: tests that are marked `world`
pytest_host     the program that runs such tests
pytest_inside   pytest in a world
"""
