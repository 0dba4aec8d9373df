"""The simulated machine: one processor, a clock, files, sockets, terminals and processes.

kernel          the scheduler: virtual time, and threads of which one runs at a time
virtual_clocks  `time` and `datetime`
task_locks      locks, and threads as `_thread` has them
files           descriptors, pipes, and what else `os` opens
network         who has which address; what the weather does
endpoints       what is behind a TCP, UDP or Unix socket
world_sockets   `socket.socket`, made of an endpoint
polling         `select`, `poll` and `epoll`
terminals       pseudo-terminals, with what pyserial asks of termios
processes       child processes, signals, `os.kill`
patches         puts all of it in the place of the standard library's
"""
