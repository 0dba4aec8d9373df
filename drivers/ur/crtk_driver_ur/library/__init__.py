"""Control by the vendor library ur-rtde, in a process of its own. Nothing outside this folder imports it."""
